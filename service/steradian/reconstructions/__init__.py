"""Reconstructions: from a stored scan to a stored volume, its projections and figures."""
