"""Recordings: sessions in MCAP, foreign tables, and checks of both."""
