"""Scans: acquisition from a scanner, HDF5 scan files, import and export."""
