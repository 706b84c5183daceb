"""Estimators that run in the loop beside a law: a memory in, a memory and an estimate out."""
