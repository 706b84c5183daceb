"""Fault campaign: every fault injected into a session, with the state it leads to, and when."""
