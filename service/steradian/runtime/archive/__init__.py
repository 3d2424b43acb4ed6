"""Upload of scans to the object store, and migration of a data folder into it."""
