"""Scan files (HDF5): schema, writer, readers, verification."""
