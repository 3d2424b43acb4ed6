"""Image quality metrics: correlation, sharpness, resolution and contrast.

A projection shows each column's maximum and so hides what lies beneath it: state the volume's figures beside it.
"""

from steradian.quality.comparison import compare
from steradian.quality.contrasts import contrast, contrast_to_noise, modulation, peak_to_background
from steradian.quality.pearson import correlation
from steradian.quality.regions import disc, of_interest, rectangle
from steradian.quality.sharpness import sobel, tenenbaum
from steradian.quality.spread import Spread, direct_fwhm, edge_spread, line_spread
from steradian.quality.width import Width, width

__all__ = [
    "Spread",
    "Width",
    "compare",
    "contrast",
    "contrast_to_noise",
    "correlation",
    "direct_fwhm",
    "disc",
    "edge_spread",
    "line_spread",
    "modulation",
    "of_interest",
    "peak_to_background",
    "rectangle",
    "sobel",
    "tenenbaum",
    "width",
]
