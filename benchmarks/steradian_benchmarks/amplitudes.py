"""Benchmark of image amplitudes through sparse masks, against dense grids of the same area."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian import phantoms
from steradian.benchmarks.report_pages import replace_between_markers
from steradian.core.progress import Progress
from steradian.imaging import Acquisition, ImageGrid, reconstruct
from steradian.imaging.geometry.polygons import Outline, contains
from steradian.masks import (
    Mask,
    PointOfInterest,
    combined_mask,
    custom_mask,
    equi_steradian_mask,
    grid_mask,
    hexagonal_mask,
    poisson_disc_mask,
    random_mask,
)

SIDE, SPEED, INTERVAL, DEPTH = 12e-3, 1500.0, 16e-9, 3.6e-3
SAMPLES, MODES, PITCH = 448, 120, 100e-6
SHOWN = (2.2e-3, 5e-3)
BEGIN, END = (
    "<!-- amplitudes: begin, written by `python -m steradian_benchmarks amplitudes` -->",
    "<!-- amplitudes: end -->",
)

Row = dict[str, Any]


def arrangements(count: int = 1600) -> dict[str, Mask]:
    """Return six arrangements of about ``count`` points, and a rectangular field as an import creates it."""
    share = SIDE**2 / count
    aims = [PointOfInterest(depth=DEPTH, count=count // 2, offset=(x, 0.0)) for x in (-2e-3, 2e-3)]
    line = round(np.sqrt(count))
    field = (np.argwhere(np.ones((2 * line, line))) - [line, line / 2]) * (SIDE / 2 / line)
    return {
        "equi-steradian": equi_steradian_mask(SIDE, DEPTH, count),
        "grid": grid_mask(SIDE, line, SIDE / line, centred=True),
        "hexagonal": hexagonal_mask(SIDE, float(np.sqrt(share * 2 / np.sqrt(3)))),
        "random": random_mask(SIDE, count),
        "Poisson-disc": poisson_disc_mask(SIDE, float(np.sqrt(0.7 * share))),
        "combined": combined_mask(SIDE, aims),
        "imported field": custom_mask(field, SIDE),
    }


def objects() -> dict[str, phantoms.Balls]:
    """Return the test objects: a ball of s = 100 µm and amplitude 1, and a tree of vessels of amplitude about 1."""
    ball = phantoms.Balls(np.array([[0.0, 0.0, DEPTH]]), np.array([100e-6]), np.array([1.0]))
    return {"ball": ball, "tree": phantoms.vessels(0, radius=2.5e-3, thickest=150e-6, generations=4)}


def amplitudes(*, count: int = 1600, progress: Progress | None = None) -> list[Row]:
    """Measure the amplitudes of test objects in images through each mask arrangement.

    Parameters
    ----------
    count
        About how many points a mask has.
    progress
        Told after each mask.

    Returns
    -------
    list of dict
        One row an arrangement: points, sensed area (mm²), and for each object the amplitude of the image through the
        mask (``ball``, ``tree``) and through a dense grid over the same area (``ball_dense``, ``tree_dense``).
    """
    rows: list[Row] = []
    made, seen = arrangements(count), objects()
    for done, (name, mask) in enumerate(made.items()):
        row: Row = {"mask": name, "points": mask.count, "sensed_mm2": 1e6 * mask.sensed_area}
        assert mask.outline is not None
        for what, balls in seen.items():
            row[what] = _amplitude(balls, mask.positions, mask.weights)
            dense = _dense(mask.outline)
            row[f"{what}_dense"] = _amplitude(balls, dense, np.full(len(dense), PITCH**2))
        rows.append(row)
        if progress:
            progress("masks", done + 1, len(made))
    return rows


def _dense(outline: Outline) -> NDArray[np.float64]:
    """Return the points of a dense grid of 100 µm pitch within the outline."""
    axis = (np.arange(MODES) + 0.5 - MODES / 2) * PITCH
    points = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    found: NDArray[np.float64] = points[contains(outline, points)]
    return found


def _amplitude(balls: phantoms.Balls, positions: NDArray[np.float64], weights: NDArray[np.float64]) -> float:
    """Return the amplitude of the image relative to the true volume, fitted by least squares."""
    traces = phantoms.pressure(balls, positions, samples=SAMPLES, sampling_interval=INTERVAL, sound_speed=SPEED)
    acquisition = Acquisition(traces, positions, dt=INTERVAL, sound_speed=SPEED, aperture=SIDE, weights=weights)
    volume = reconstruct(acquisition, ImageGrid(MODES, depth=SHOWN))
    truth = phantoms.rasterise(balls, volume).values.astype(np.float64)
    return float(np.vdot(truth, volume.values) / np.vdot(truth, truth))


def table(rows: list[Row]) -> str:
    """Return the measured amplitudes as a Markdown table beside the true amplitude."""
    lines = [
        "| arrangement | points | sensed (mm²) | ball, true 1 | dense | ratio | tree, true 1 | dense | ratio |",
        "|---|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for row in rows:
        cells = [row["mask"], f"{row['points']:,}", f"{row['sensed_mm2']:.1f}"]
        for what in objects():
            here, dense = row[what], row[f"{what}_dense"]
            cells += [f"{here:.3f}", f"{dense:.3f}", f"{here / dense:.3f}"]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def write_page(page: Path, rows: list[Row]) -> None:
    """Replace the table between the markers of a documentation page."""
    replace_between_markers(page, BEGIN, END, table(rows))
