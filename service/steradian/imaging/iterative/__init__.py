"""Iterative reconstruction: ISTA, FISTA, total variation and their stopping rules."""
