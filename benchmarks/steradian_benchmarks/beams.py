"""Benchmark of scan time and image quality with several interrogation beams against one beam.

A yarn, closed-form A-lines with noise, reconstructed from the points of one beam's mask and from those that a pattern
of beams measures in its place; times are the preview's, and the simulated hardware's by its own clock.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian import phantoms, quality
from steradian.benchmarks.report_pages import replace_between_markers
from steradian.core.progress import Progress
from steradian.imaging import Acquisition, ImageGrid, Volume, reconstruct
from steradian.imaging.signal.conditioning import Conditioning
from steradian.masks import Mask, equi_steradian_mask, multi_beam_mask
from steradian.masks.multi_beam import read_beams
from steradian.plans import Link, ScanPlan, VisitOrder, preview
from steradian_benchmarks.simulated_scan_time import simulated_scan_seconds

APERTURE, DEPTH, POINTS = 13.56e-3, 3.6e-3, 1600
INTERVAL, SAMPLES, SPEED = 8e-9, 1024, 1480.0
MODES, SHOWN, BAND, NOISE = 226, (1e-3, 8e-3), (None, 20e6), 30.0
DISC = 7.2e-3
SEEDS, TURNS = 5, (0.0, 0.03, 0.5, 1.0)
PATTERNS = tuple(
    (*pattern, places)
    for pattern in (("4x4", 0.5e-3), ("4x4", 0.8e-3), ("16", 0.4e-3), ("8x8", 0.4e-3))
    for places in (1.0, 1.12)
)
"""Beams, their spacing in m, and how many times the fewest places."""
BEGIN, END = "<!-- beams: begin, written by `python -m steradian_benchmarks beams` -->", "<!-- beams: end -->"

Row = dict[str, Any]


def beams(*, points: int = POINTS, seeds: int = SEEDS, progress: Progress | None = None) -> list[Row]:
    """Measure scan times and image quality of one beam and of multi-beam patterns.

    Parameters
    ----------
    points
        About how many points the mask of one beam has.
    seeds
        How many yarns, each with noise of its own.
    progress
        Told after each yarn.

    Returns
    -------
    list of dict
        One row a choice of points: ``beams``, ``spacing_m``, ``places``, ``points``; ``expected_s`` by the preview,
        ``simulated_s`` by the simulated hardware's clock, ``share`` of one beam's and its ``bound``, one over the
        beams; displacement of the points asked for; ``mip`` and ``volume``, correlations of the z-projection (in a
        disc) and of the volume with the truth, means over the yarns and over the same mask turned, that is over other
        points, as good; ``mip_sd`` and ``volume_sd``, between the turned ones: what the choice of points makes.
    """
    turned = [_rotated(equi_steradian_mask(APERTURE, DEPTH, points), turn) for turn in TURNS]
    plans = [ScanPlan.create(mask=turned[0], order=VisitOrder.SHORTEST, link=Link(byte_rate=None))]
    rows: list[Row] = [{"beams": 1, "kind": "mask"}]
    masks = list(turned)
    for words, spacing, times in PATTERNS:
        pattern = read_beams(words, spacing)
        places = round(times * -(-turned[0].count // len(pattern)))
        masks += [multi_beam_mask(mask, pattern, places=places) for mask in turned]
        plans.append(plans[0].replace(mask=masks[-len(turned)], beams=pattern))
        rows.append({"beams": len(pattern), "kind": words, "spacing_m": spacing})
    found = np.empty((seeds, len(rows), len(turned), 2))
    for seed in range(seeds):
        found[seed] = _correlations(seed, masks).reshape(found.shape[1:])
        if progress:
            progress("yarns", seed + 1, seeds)
    each = found.mean(axis=0)
    for row, plan, mean, off in zip(rows, plans, each.mean(axis=1), each.std(axis=1, ddof=1), strict=True):
        row |= {"points": plan.mask.count, "places": plan.mask.count // row["beams"], **_times(plan)}
        row |= {"share": row["simulated_s"] / rows[0]["simulated_s"], "bound": 1 / row["beams"]}
        row |= {"mip": float(mean[0]), "volume": float(mean[1]), "mip_sd": float(off[0]), "volume_sd": float(off[1])}
    return rows


def _rotated(mask: Mask, turn: float) -> Mask:
    """Return a mask rotated about its centre, as a statistically equivalent mask with different points."""
    turning = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    return mask.replace(positions=mask.positions @ turning, outline=None)


def _times(plan: ScanPlan) -> Row:
    cost = preview(plan)
    return {"expected_s": cost.total_seconds, "simulated_s": simulated_scan_seconds(plan), **cost.displacement}


def _correlations(seed: int, masks: list[Mask]) -> NDArray[np.float64]:
    """Return (masks, 2) correlations of images with the true object, of the z-projection and of the volume."""
    balls, found = phantoms.yarn(seed), []
    for mask in masks:
        volume = _image(balls, mask, seed)
        truth = phantoms.rasterise(balls, volume)
        assert volume.axes.y is not None
        disc = quality.disc(volume.axes.x, volume.axes.y, DISC)
        flat = quality.correlation(volume.mip("z"), truth.mip("z"), disc)
        found.append((flat, quality.correlation(volume.values[::2, ::2], truth.values[::2, ::2])))
    return np.array(found)


def _image(balls: phantoms.Balls, mask: Mask, seed: int) -> Volume:
    where = mask.positions
    clean = phantoms.pressure(balls, where, samples=SAMPLES, sampling_interval=INTERVAL, sound_speed=SPEED)
    traces = Conditioning(band=BAND).apply(
        phantoms.add_noise(clean, NOISE, seed=seed), where, sampling_interval=INTERVAL, aperture=APERTURE
    )
    acquisition = Acquisition(traces, where, dt=INTERVAL, sound_speed=SPEED, aperture=APERTURE, weights=mask.weights)
    return reconstruct(acquisition, ImageGrid(MODES, depth=SHOWN))


def table(rows: list[Row]) -> str:
    """Return the measurements as a Markdown table."""
    lines = [
        "| points | places | A-lines | time (s) | simulated (s) | of one beam's | bound | moved, median (µm) |"
        " z-projection | volume |",
        "|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for row in rows:
        name = "one beam" if row["beams"] == 1 else f"{row['kind']} beams, {1e3 * row['spacing_m']:g} mm apart"
        cells = [name, f"{row['places']:,}", f"{row['points']:,}"]
        cells += [f"{row['expected_s']:.2f}", f"{row['simulated_s']:.2f}"]
        cells += [f"1/{1 / row['share']:.2f}", f"1/{row['beams']}"]
        cells += [f"{1e6 * row['median']:.0f}" if "median" in row else ""]
        cells += [f"{row['mip']:.4f} ± {row['mip_sd']:.4f}", f"{row['volume']:.4f} ± {row['volume_sd']:.4f}"]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def write_page(page: Path, rows: list[Row]) -> None:
    """Replace the table between the markers of a documentation page."""
    replace_between_markers(page, BEGIN, END, table(rows))
