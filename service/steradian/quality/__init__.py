"""Image quality metrics: correlation, sharpness, resolution and contrast.

A projection shows each column's maximum and so hides what lies beneath it: state the volume's figures beside it.
"""

from steradian.quality.comparison import compare
from steradian.quality.contrasts import contrast, contrast_to_noise, modulation, peak_to_background
from steradian.quality.pearson import correlation
from steradian.quality.pulse_noise import PulseNoise, measure_pulse_noise
from steradian.quality.region_files import (
    read_regions,
    region_from_json,
    region_from_text,
    region_to_json,
    write_regions,
)
from steradian.quality.region_statistics import (
    AboveThreshold,
    Box,
    Ellipsoid,
    Polygon,
    RegionOfInterest,
    RegionStatistics,
    region_statistics,
)
from steradian.quality.regions import above_threshold, bounding_slices, disc
from steradian.quality.registration import Shift, estimate_shift
from steradian.quality.resolution import SpreadFit, direct_fwhm, edge_spread, line_spread
from steradian.quality.sharpness import sobel, tenenbaum
from steradian.quality.tables import write_csv
from steradian.quality.time_courses import TimeCourseFit, fit_time_course, summarise_courses, temporal_snr
from steradian.quality.vessel_filter import vesselness
from steradian.quality.width import Width, width

__all__ = [
    "AboveThreshold",
    "Box",
    "Ellipsoid",
    "Polygon",
    "PulseNoise",
    "RegionOfInterest",
    "RegionStatistics",
    "Shift",
    "SpreadFit",
    "TimeCourseFit",
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
    "estimate_shift",
    "fit_time_course",
    "line_spread",
    "measure_pulse_noise",
    "modulation",
    "peak_to_background",
    "read_regions",
    "region_from_json",
    "region_from_text",
    "region_statistics",
    "region_to_json",
    "sobel",
    "summarise_courses",
    "temporal_snr",
    "tenenbaum",
    "vesselness",
    "width",
    "write_csv",
    "write_regions",
]
