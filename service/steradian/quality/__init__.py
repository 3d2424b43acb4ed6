"""Image quality metrics: correlation, sharpness, resolution and contrast.

A projection shows each column's maximum and so hides what lies beneath it: state the volume's figures beside it.
"""

from steradian.quality.comparison import compare
from steradian.quality.contrasts import contrast, contrast_to_noise, modulation, peak_to_background
from steradian.quality.pearson import correlation
from steradian.quality.regions import above_threshold, bounding_slices, disc
from steradian.quality.resolution import SpreadFit, direct_fwhm, edge_spread, line_spread
from steradian.quality.sharpness import sobel, tenenbaum
from steradian.quality.width import Width, width

__all__ = [
    "SpreadFit",
    "Width",
    "above_threshold",
    "bounding_slices",
    "compare",
    "contrast",
    "contrast_to_noise",
    "correlation",
    "direct_fwhm",
    "disc",
    "edge_spread",
    "line_spread",
    "modulation",
    "peak_to_background",
    "sobel",
    "tenenbaum",
    "width",
]
