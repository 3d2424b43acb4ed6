"""Benchmarks of the reconstruction: functions that return tables (lists of dicts)."""

from steradian.benchmarks.accuracy import accuracy
from steradian.benchmarks.speed import speed

__all__ = ["accuracy", "speed"]
