"""A-lines for scan files."""

from dataclasses import dataclass

import numpy as np


@dataclass
class Aline:
    """An A-line as a driver delivers it and the store takes it."""

    point: int
    samples: np.ndarray
    shot: int = 1
    scale: float = 1.0
    energy: float = 1.0
    wavelength_m: float = 1.55e-6
    fire_time_s: float = 0.0
    averages: int = 1
    time_zero_offset_s: float = 0.0
    dc_v: float = 0.0
    gain_db: float = 0.0
    quality: int = 0
