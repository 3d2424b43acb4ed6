"""Benchmark of series: one job of all frames against a reconstruction of each frame, and warm against cold fits."""

from __future__ import annotations

import shutil
import tempfile
import time
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from fabry_perot.simulator import phantoms
from steradian.benchmarks.speed_cases import INTERVAL, SPEED, YARN
from steradian.core.progress import Progress
from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.plan_cache import PlanCache
from steradian.reconstructions.pipeline.run import reconstruct_scan
from steradian.reconstructions.series.reconstruct import reconstruct_series
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from steradian.scans.importing.scan_writer import ImportedAline

Row: TypeAlias = dict[str, Any]
FRAMES, MODES, REPEATS = 20, 226, 2
LIMITS = {"nedner": 1.15, "iterative": 0.5}
NOISE_DB = {"nedner": 30.0, "iterative": 45.0}
"""Of the largest sample: noise of 30 dB ends a fit of the yarn after three steps, of which a warm one saves two."""


def series(*, quick: bool = False, progress: Progress | None = None) -> list[Row]:
    """Time series of the paper's yarn scan (1,605 points, 1,024 samples) against its frames one by one.

    Parameters
    ----------
    quick
        A small scan: a check that it runs, no measurement.
    progress
        Called before each run.

    Returns
    -------
    list of dict
        One row a method. ``noise_db``: below the largest sample; ``series_s``: one series of all frames with its file
        and picture; ``frames_s``: as many single reconstructions, with a shared plan, their files and pictures;
        ``ratio``: the least of both in turns, of the method iterative without the first frame, which starts from
        nothing; ``limit``: what the ratio must not exceed.
    """
    rows = []
    frames, modes = (3, 24) if quick else (FRAMES, MODES)
    for method in LIMITS:
        with tempfile.TemporaryDirectory() as folder:
            scan = Path(folder) / "scan.h5"
            _write(scan, frames, quick, NOISE_DB[method])
            parameters = ReconstructionParameters.create(method=method, modes=modes)
            reconstruct_scan(scan, Path(folder) / "first", parameters, frame=0)  # loads the compiled code
            seconds: dict[str, list[float]] = {"series": [], "frames": []}
            for turn in range(1 if quick else REPEATS):
                for name, run in (("series", _series), ("frames", _frames)):
                    if progress is not None:
                        progress(f"{method}, {name}", turn, REPEATS)
                    began = time.perf_counter()
                    run(scan, Path(folder) / name, parameters, frames)
                    seconds[name].append(time.perf_counter() - began)
                    shutil.rmtree(Path(folder) / name)
        least = {name: min(times) for name, times in seconds.items()}
        single = least["frames"] / frames
        first = single if method == "iterative" else 0.0
        count = frames - 1 if method == "iterative" else frames
        rows.append(
            {
                "method": method,
                "frames": frames,
                "noise_db": NOISE_DB[method],
                "modes": modes,
                "series_s": least["series"],
                "frames_s": least["frames"],
                "ratio": (least["series"] - first) / (count * single),
                "limit": LIMITS[method],
            }
        )
    return rows


def _series(scan: Path, folder: Path, parameters: ReconstructionParameters, frames: int) -> None:
    reconstruct_series(scan, folder, parameters)


def _frames(scan: Path, folder: Path, parameters: ReconstructionParameters, frames: int) -> None:
    plans = PlanCache(most=1)
    for number in range(frames):
        reconstruct_scan(scan, folder / str(number), parameters, frame=number, plans=plans)


def _write(path: Path, frames: int, quick: bool, noise_db: float) -> None:
    """Write a scan of the yarn, the same object in each frame with other noise."""
    mask = equi_steradian_mask(YARN, 3.6e-3, 100 if quick else 1600)
    samples = 256 if quick else 1024
    plan = ScanPlan.create(
        mask=mask, samples=samples, sampling_interval=INTERVAL, sound_speed=SPEED, frames=frames, order="given"
    )
    pressure = phantoms.pressure(phantoms.yarn(0), mask.positions, np.arange(samples) * INTERVAL, SPEED)
    peak, random = float(np.abs(pressure).max()), np.random.default_rng(0)
    create_scan_file(path, plan)
    with ScanFileWriter(path) as store:
        for frame in range(frames):
            noisy = pressure + peak * 10 ** (-noise_db / 20) * random.standard_normal(pressure.shape)
            scale = 1.5 * peak / 32767
            lines = np.rint(noisy / scale).astype(np.int16)
            store.append(ImportedAline(frame * mask.count + n, line, scale, shot=0) for n, line in enumerate(lines))
