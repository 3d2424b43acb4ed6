"""Compute resources: memory limit and thread pool."""
