"""Live reconstruction of a scan in progress."""
