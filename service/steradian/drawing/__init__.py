"""Plot style and the two renderers (pixels, matplotlib)."""
