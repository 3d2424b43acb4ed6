"""Drawing: plot style and two renderers (raster and matplotlib)."""
