"""Series of volumes: one reconstruction of a scan with several frames (wavelengths, repetitions)."""
