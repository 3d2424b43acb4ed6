"""Benchmarks of the reconstruction: functions that return tables (lists of dicts)."""
