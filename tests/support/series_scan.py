"""Scan file with a ball of blood at several wavelengths, each measured several times."""

import numpy as np

from steradian import ScanPlan, grid_mask
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from steradian.spectroscopy import chromophore
from support.alines import Aline

LIGHTS = (750e-9, 850e-9)
REPEATS, SAMPLES, INTERVAL = 2, 128, 20e-9
MASK = grid_mask(2.4e-3, 12, 0.2e-3)
SATURATION = 0.8
DEPTH = 1e-3


def write_scan(path, repeats=REPEATS, frames=None, step=0.0):
    """Write a scan of a ball of blood at 1 mm depth in little noise.

    Only the first ``frames`` have A-lines; in each the ball is ``step`` (m) farther along x.
    """
    plan = ScanPlan.create(
        mask=MASK, samples=SAMPLES, sampling_interval=INTERVAL, frames=repeats, excitation=LIGHTS, order="given"
    )
    create_scan_file(path, plan)
    pair = [chromophore(name).at(LIGHTS) for name in ("HbO2", "Hb")]
    colours = SATURATION * pair[0] + (1 - SATURATION) * pair[1]
    random = np.random.default_rng(0)
    with ScanFileWriter(path) as store:
        for frame in range(len(LIGHTS) * repeats if frames is None else frames):
            beside = np.linalg.norm(MASK.positions - [frame * step, 0], axis=1)
            distance = np.hypot(beside, DEPTH)[:, None]
            late = distance - 1500 * INTERVAL * np.arange(SAMPLES)
            ball = late * np.exp(-((late / 150e-6) ** 2) / 2) / distance
            ideal = 2e4 * ball / np.abs(ball).max() * colours[frame // repeats] / colours.max()
            lines = (ideal + random.normal(0, 20, ideal.shape)).round().astype(np.int16)
            store.append(Aline(frame * MASK.count + n, line, energy=1.0) for n, line in enumerate(lines))
    return path
