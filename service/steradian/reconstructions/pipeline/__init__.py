"""Reconstruction pipeline from scan file to volume file: parameters, plan cache, execution, diagnostics."""
