"""Simulated laboratory hardware for the example: DAQ card, digitiser, tunable laser and optical table."""
