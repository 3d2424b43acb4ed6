"""Compiled CPU engine: batches of 16 signals, three passes over one buffer (ADR 4)."""
