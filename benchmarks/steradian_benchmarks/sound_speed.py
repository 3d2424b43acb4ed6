"""Accuracy of the sound-speed estimate in 60 simulated scans: apertures, objects, noise, with and without a delay."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from steradian import phantoms
from steradian.benchmarks.report_pages import replace_between_markers
from steradian.core.progress import Progress
from steradian.reconstructions.studies.sound_speed_curve import SoundSpeedCurve
from steradian.reconstructions.studies.sound_speed_search import find_sound_speed

SIDES, OBJECTS = (4e-3, 6e-3, 8e-3, 10e-3, 14e-3), ("points", "vessels", "smooth")
NOISES, DELAYS = (20.0, 30.0), (0.0, 0.6e-6)
"""Sides of the square aperture (m), objects, ratio of the largest sample to noise (dB), begin of the record (s)."""
COUNT, INTERVAL, SEED = 30, 20e-9, 500
BEGIN, END = (
    "<!-- sound speed: begin, written by `python -m steradian_benchmarks sound-speed` -->",
    "<!-- sound speed: end -->",
)

Row = dict[str, Any]


def scene(kind: str, side: float, seed: int) -> phantoms.Balls:
    """Return a random test object: eight balls of s = 60 µm, vessels of up to 120 µm, or twelve balls of 120–250 µm."""
    random = np.random.default_rng([seed, 1])
    radius = min(0.35 * side, 2.5e-3)
    if kind == "vessels":
        return phantoms.vessels(seed, radius=radius, thickest=120e-6, generations=4)
    count = 8 if kind == "points" else 12
    places = np.column_stack([random.uniform(-radius, radius, (count, 2)), random.uniform(1.5e-3, 4e-3, count)])
    sigmas = np.full(count, 60e-6) if kind == "points" else random.uniform(120e-6, 250e-6, count)
    return phantoms.Balls(places, sigmas, random.uniform(0.5, 1, count))


def search(kind: str, side: float, noise_db: float, delay: float, seed: int) -> tuple[float, SoundSpeedCurve]:
    """Simulate a scan of 900 sensors on a jittered grid; return its true and its estimated sound speed."""
    random = np.random.default_rng([seed, 0])
    speed = float(random.uniform(1430, 1570))
    axis = (np.arange(COUNT) + 0.5) / COUNT - 0.5
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    positions = side * (grid + random.uniform(-0.4, 0.4, grid.shape) / COUNT)
    samples = round((0.5 * side + 6e-3) / 1500 / INTERVAL)
    clean = phantoms.pressure(
        scene(kind, side, seed),
        positions,
        samples=samples,
        sampling_interval=INTERVAL,
        sound_speed=speed,
        time_zero=delay,
    )
    traces = phantoms.add_noise(clean, noise_db, convention="peak", seed=seed)
    tried = np.linspace(1380, 1620, 25)
    curve = find_sound_speed(
        traces, positions, tried, sampling_interval=INTERVAL, aperture=side, weights=np.full(900, side**2 / 900),
        time_zero=delay,
    )  # fmt: skip
    return speed, curve


def sound_speeds(*, progress: Progress | None = None) -> list[Row]:
    """Estimate the sound speed of all simulated scans; one row a scan, in m/s."""
    rows: list[Row] = []
    cases = list(product(SIDES, OBJECTS, NOISES, DELAYS))
    for number, (side, kind, noise, delay) in enumerate(cases):
        true, curve = search(kind, side, noise, delay, SEED + number)
        rows.append(
            {
                "aperture_mm": 1e3 * side,
                "object": kind,
                "noise_db": noise,
                "delay_us": 1e6 * delay,
                "true": true,
                "found": curve.best,
                "standard_error": curve.standard_error,
                "sharpest": curve.sound_speeds[int(np.argmax(curve.sharpness))],
            }
        )
        if progress:
            progress("scans", number + 1, len(cases))
    return rows


def summary(rows: list[Row]) -> dict[str, float]:
    """Return mean error, RMS error (% of the truth), and the share of confidence intervals that contain the truth."""
    off = np.array([100 * (row["found"] / row["true"] - 1) for row in rows])
    errors = np.array([100 * (row["standard_error"] or 0.0) / row["true"] for row in rows])
    held = np.abs(off) <= errors
    return {
        "scans": len(rows),
        "bias": float(off.mean()),
        "rms": float(np.sqrt(np.mean(off**2))),
        "largest": float(np.abs(off).max()),
        "error": float(np.median(errors)),
        "held": 100 * float(held.mean()),
    }


def table(rows: list[Row]) -> str:
    """Return the results as Markdown tables: by group, then all scans."""
    lines = [
        "| scans | number | mean error | r.m.s. error | largest | median ± stated | truth within ± |",
        "|---|--:|--:|--:|--:|--:|--:|",
    ]
    groups: list[tuple[str, list[Row]]] = []
    for key, unit in (("object", ""), ("aperture_mm", " mm"), ("noise_db", " dB"), ("delay_us", " µs of delay")):
        for value in dict.fromkeys(row[key] for row in rows):
            name = value if isinstance(value, str) else f"{value:.3g}{unit}"
            groups.append((name, [row for row in rows if row[key] == value]))
    for name, some in [*groups, ("all", rows)]:
        of = summary(some)
        lines.append(
            f"| {name} | {of['scans']} | {of['bias']:+.3f} % | {of['rms']:.3f} % | {of['largest']:.3f} % |"
            f" {of['error']:.3f} % | {of['held']:.0f} % |"
        )
    return "\n".join(lines)


def write_page(page: Path, rows: list[Row]) -> None:
    """Replace the table between the markers of a documentation page."""
    replace_between_markers(page, BEGIN, END, table(rows))
