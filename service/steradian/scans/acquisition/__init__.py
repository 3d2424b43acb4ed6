"""Acquisition: running a plan on a scanner, resuming, interlocks, emergency stop, faults."""
