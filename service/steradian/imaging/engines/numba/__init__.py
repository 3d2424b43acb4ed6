"""Compiled CPU engine (Numba): batches of 16 signals, three passes over one buffer (ADR 4)."""
