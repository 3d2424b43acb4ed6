"""Geometry of sensors and images: cells, areas, outlines, periods and depths."""
