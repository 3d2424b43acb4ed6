"""Scan acquisition and the HDF5 scan-file format."""
