"""Benchmarks of scanner link, queue, storage, masks, GPU and the paper; each returns a table (list of dicts)."""
