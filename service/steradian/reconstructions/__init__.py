"""Reconstruction pipeline from scan files to volume files."""
