"""Benchmark of scan designs: predicted contrast and width of a vessel beside those of simulated scans.

A scan differs from what the prediction assumes: the vessel is a sum of balls of another length, up to 0.15 mm away from
its expected place, along x or y; the whole record is reconstructed as of a scan file, with other noise.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from steradian.benchmarks.report_pages import replace_between_markers
from steradian.comparisons.design_result import MAX_SCATTER
from steradian.comparisons.vessel_image import LEAST_UNIT, MAX_CONTRAST_DB, RING, SLAB, ImagingMethod, VesselImage
from steradian.core.progress import Progress
from steradian.imaging import Volume
from steradian.masks import Counted, mask_by_count
from steradian.phantoms import pressure
from steradian.phantoms.spheres_and_cylinders import cylinder
from steradian.quality import peak_to_background, width
from steradian.quality.profiles import profile
from steradian.quality.pulse_noise import PulseNoise
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.run import reconstruct_in_memory
from steradian.scans.recording import Recording

SCANS = 20
ARRANGEMENTS: tuple[Counted, ...] = ("equi-steradian", "grid", "hexagonal", "poisson-disc")
METHODS: tuple[ImagingMethod, ...] = ("direct", "iterative")
CONTRAST_DB, WIDTH = 2.0, 0.1
"""Greatest difference of the contrast in dB, and relative one of the width."""
JITTER = 150e-6
"""Greatest distance in m along x and y of the vessel from where it is expected."""
HALF_LENGTHS = 2.5e-3, 4e-3
"""Least and greatest half length of the vessel in m."""
DT, SOUND_SPEED = 8e-9, 1500.0
MARKERS = "<!-- budget: begin, written by `python -m steradian_benchmarks budget` -->", "<!-- budget: end -->"
Row = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """One scan of the benchmark; lengths in metres, noise of one pulse in dB."""

    seed: int
    arrangement: Counted
    count: int
    averages: int
    noise_db: float
    aperture: float
    place: tuple[float, float, float]
    diameter: float

    @classmethod
    def random(cls, seed: int) -> Case:
        """Return the scan of a seed."""
        draw = np.random.default_rng([seed, 11])
        averages = int(2 ** draw.integers(0, 7))
        averaged_db = float(draw.uniform(16, 40))
        return cls(
            seed=seed,
            arrangement=ARRANGEMENTS[seed % len(ARRANGEMENTS)],
            count=round(10 ** draw.uniform(2.7, 3.7)),
            averages=averages,
            noise_db=averaged_db - 10 * np.log10(averages),
            aperture=float(draw.uniform(8e-3, 13.56e-3)),
            place=(draw.uniform(-1e-3, 1e-3), draw.uniform(-1e-3, 1e-3), draw.uniform(1.5e-3, 4e-3)),
            diameter=float(draw.uniform(100e-6, 300e-6)),
        )


def budget(*, quick: bool = False, progress: Progress | None = None) -> list[Row]:
    """Predict and simulate scans; one row a scan and method.

    Parameters
    ----------
    quick
        Two scans and the direct method only.
    progress
        Called after each scan.
    """
    rows = []
    scans = 2 if quick else SCANS
    for seed in range(scans):
        rows += compare(Case.random(seed), METHODS[:1] if quick else METHODS)
        if progress:
            progress("scans", seed + 1, scans)
    return rows


def compare(case: Case, methods: tuple[ImagingMethod, ...] = METHODS) -> list[Row]:
    """Return the predicted and the measured figures of one scan for each method."""
    mask = mask_by_count(case.arrangement, case.aperture, case.count, depth=case.place[2], offset=case.place[:2])
    image = VesselImage(mask, case.place, case.diameter, PulseNoise(case.noise_db), case.averages, DT, SOUND_SPEED)
    draw = np.random.default_rng([case.seed, 12])
    axis = int(draw.integers(0, 2))
    along = np.eye(3)[1 - axis]
    shift = draw.uniform(-JITTER, JITTER, 3)
    place = np.asarray(case.place) + shift
    balls = cylinder(case.diameter, place, along, float(draw.uniform(*HALF_LENGTHS)), DT * SOUND_SPEED)
    traces = pressure(balls, mask.positions, samples=1024, sampling_interval=DT, sound_speed=SOUND_SPEED)
    above = pressure(balls, place[None, :2], samples=1024, sampling_interval=DT, sound_speed=SOUND_SPEED)
    sigma = float(np.abs(above).max()) * 10 ** (-case.noise_db / 20)
    noise = np.zeros_like(traces)
    for _ in range(case.averages):
        noise += draw.standard_normal(traces.shape, dtype=np.float32)
    recording = Recording(
        traces=traces + np.float32(sigma / case.averages) * noise,
        scale=1.0,
        positions=mask.positions,
        weights=mask.weights,
        sampling_interval=DT,
        sound_speed=SOUND_SPEED,
        aperture=mask.aperture,
        time_zero=0.0,
        grid=None,
        depth=case.place[2],
        planned=mask.count,
        provenance={},
        outline=mask.outline,
    )
    rows = []
    for method in methods:
        expected = image.expect(method)
        chosen = ReconstructionParameters(method="nedner" if method == "direct" else "iterative")
        found = measure(reconstruct_in_memory(recording, chosen), place, axis, case.diameter)
        row: Row = {
            "seed": case.seed,
            "method": method,
            "arrangement": case.arrangement,
            "points": mask.count,
            "averages": case.averages,
            "noise_db": case.noise_db,
            "aperture_m": case.aperture,
            "depth_m": float(place[2]),
            "diameter_m": case.diameter,
            "along": "yx"[axis],
            "usable": bool(expected.width_scatter <= MAX_SCATTER),
            "scatter": expected.width_scatter,
            "contrast_expected_db": expected.contrast_db,
            "contrast_db": min(found[0], MAX_CONTRAST_DB) if method == "iterative" else found[0],
            "width_expected_m": expected.width,
            "width_m": found[1],
        }
        rows.append(row)
    return rows


def measure(volume: Volume, place: np.ndarray, axis: int, diameter: float) -> tuple[float, float]:
    """Return the contrast in dB and the width in m along ``axis`` (0: x, 1: y)."""
    unit = max(diameter, LEAST_UNIT)
    reach = RING[1] * unit
    middle = np.flatnonzero(np.abs(volume.coordinates("xy"[1 - axis]) - place[1 - axis]) <= SLAB)
    slab = np.moveaxis(np.take(np.asarray(volume.values), middle, axis=1 - axis), 1 - axis, 0)
    distance = np.hypot(volume.coordinates("xy"[axis])[:, None] - place[axis], volume.coordinates("z") - place[2])
    ring = (distance > RING[0] * unit) & (distance < reach)
    ratio = peak_to_background(slab, *(np.broadcast_to(each, slab.shape) for each in (distance <= unit, ring)))
    across = reach * np.eye(3)[axis]
    return 20 * float(np.log10(ratio)), width(*profile(volume, place - across, place + across)).fwhm


def differences(row: Row) -> tuple[float, float]:
    """Return measured minus expected contrast in dB, and the relative difference of the width."""
    return row["contrast_db"] - row["contrast_expected_db"], row["width_m"] / row["width_expected_m"] - 1


def violations(rows: list[Row]) -> list[str]:
    """Return one line for each direct scan with another contrast or, if its width counts as known, another width."""
    lines = []
    for row in (each for each in rows if each["method"] == "direct"):
        decibels, share = differences(row)
        if abs(decibels) > CONTRAST_DB:
            lines.append(f"scan {row['seed']}: contrast {decibels:+.1f} dB from the expected one")
        if row["usable"] and abs(share) > WIDTH:
            lines.append(f"scan {row['seed']}: width {share:+.0%} from the expected one")
    return lines


def read(figures: Path) -> list[Row]:
    """Return the rows of an earlier JSON file."""
    rows: list[Row] = json.loads(figures.read_text(encoding="utf-8"))["rows"]
    return rows


def table(rows: list[Row]) -> str:
    """Return the agreement of predictions and scans by method as Markdown."""
    lines = [
        "| method | scans | contrast within 2 dB | largest difference | scatter of the width | scans |"
        " width within 10 % | largest difference |",
        "|---|--:|--:|--:|---|--:|--:|--:|",
    ]
    for method in METHODS:
        own = [row for row in rows if row["method"] == method]
        for known in (True, False):
            some = [differences(row) for row in own if row["usable"] == known]
            if not some:
                continue
            decibels, shares = [abs(each[0]) for each in map(differences, own)], [abs(each[1]) for each in some]
            cells = ["", "", "", ""]
            if known:
                near = sum(each <= CONTRAST_DB for each in decibels)
                cells = [method, str(len(own)), str(near), f"{max(decibels):.1f} dB"]
            cells += ["at most 5 %" if known else "more", str(len(some)), str(sum(each <= WIDTH for each in shares))]
            lines.append("| " + " | ".join([*cells, f"{max(shares):.0%}"]) + " |")
    return "\n".join(lines)


def write_page(page: Path, rows: list[Row]) -> None:
    """Replace the table between the markers of a documentation page."""
    replace_between_markers(page, *MARKERS, table(rows))
