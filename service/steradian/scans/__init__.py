"""Scans: running a plan on a scanner, and the files that hold the A-lines."""
