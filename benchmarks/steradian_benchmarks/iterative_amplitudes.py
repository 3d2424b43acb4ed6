"""Benchmark of the amplitudes of iterative images of held-out vessels and of yarns, at two levels of noise."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np

from steradian import phantoms
from steradian.benchmarks.report_pages import replace_between_markers
from steradian.core.progress import Progress
from steradian.imaging import Acquisition, Compute, ImageGrid, Iterative, reconstruct
from steradian.masks import equi_steradian_mask
from steradian.quality import correlation

SIDE, DEPTH, SPEED, INTERVAL, SAMPLES, MODES = 13.56e-3, 3.6e-3, 1480.0, 8e-9, 1024, 226
SHOWN = (1.2e-3, 6.0e-3)
BEGIN, END = (
    "<!-- iterative: begin, written by `python -m steradian_benchmarks iterative-amplitudes` -->",
    "<!-- iterative: end -->",
)
LEAST = {30.0: 0.95, 20.0: 0.9}
"""Least amplitude by noise in dB."""
MOST = 1.05
Row: TypeAlias = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Case:
    """Kind and seeds of objects, number of points, noise in dB below the highest peak (None: none)."""

    kind: Literal["vessels", "yarn"]
    points: int
    noise: float | None
    seeds: tuple[int, ...]


HELD_OUT = (4000, 4001, 4002, 4003, 4004)
"""Seeds of vessels that no parameter was chosen with."""
CASES = (
    Case("vessels", 1400, 30.0, HELD_OUT),
    Case("vessels", 1400, 20.0, HELD_OUT),
    Case("vessels", 1400, None, HELD_OUT),
    Case("vessels", 13440, 30.0, HELD_OUT),
    Case("vessels", 13440, None, HELD_OUT),
    Case("yarn", 1605, 30.0, (0, 1, 2, 3, 4)),
    Case("yarn", 1605, 20.0, (0, 1, 2, 3, 4)),
)


def iterative_amplitudes(*, quick: bool = False, progress: Progress | None = None) -> list[Row]:
    """Measure amplitude and correlation of iterative images of held-out objects, with default options.

    Parameters
    ----------
    quick
        One object from few points: whether it runs, no measurement.
    progress
        Called after each image.

    Returns
    -------
    list of dict
        One row an image: ``kind``, ``points``, ``noise_db``, ``seed``, ``amplitude``, ``correlation``, ``products``.
    """
    cases = (Case("vessels", 100, 30.0, HELD_OUT[:1]),) if quick else CASES
    total, rows = sum(len(case.seeds) for case in cases), list[Row]()
    for case in cases:
        for seed in case.seeds:
            rows.append(_image(case, seed))
            if progress is not None:
                progress("iterative images", len(rows), total)
    return rows


def _image(case: Case, seed: int) -> Row:
    where: dict[str, Any] = {"centre": (0.0, 0.0, DEPTH)}
    balls = phantoms.yarn(seed, radius=3e-3, **where) if case.kind == "yarn" else phantoms.vessels(seed, **where)
    mask = equi_steradian_mask(SIDE, DEPTH, case.points)
    traces = phantoms.pressure(balls, mask.positions, samples=SAMPLES, sampling_interval=INTERVAL, sound_speed=SPEED)
    if case.noise is not None:
        traces = phantoms.add_noise(traces, case.noise, convention="peak", seed=seed)
    acquisition = Acquisition(traces, mask.positions, dt=INTERVAL, sound_speed=SPEED, aperture=SIDE)
    image = reconstruct(acquisition, ImageGrid(MODES, depth=SHOWN), Iterative(), compute=Compute(device="cpu"))
    truth = phantoms.rasterise(balls, image).values
    assert image.info is not None
    return {
        "kind": case.kind,
        "points": mask.count,
        "noise_db": case.noise,
        "seed": seed,
        "amplitude": float(np.vdot(truth, image.values) / np.vdot(truth, truth)),
        "correlation": float(correlation(image.values, truth)),
        "products": image.info.products,
    }


def violations(rows: list[Row]) -> list[str]:
    """Return one line for each amplitude that is out of range."""
    return [
        f"{row['kind']} {row['seed']} from {row['points']:,} points at {row['noise_db']:g} dB: amplitude "
        f"{row['amplitude']:.3f}, not {LEAST[row['noise_db']]:g} to {MOST:g}"
        for row in rows
        if row["noise_db"] in LEAST and not LEAST[row["noise_db"]] <= row["amplitude"] <= MOST
    ]


def table(rows: list[Row]) -> str:
    """Return the rows of five objects a line as Markdown: means, and the range in brackets."""
    lines = ["| objects | points | noise | amplitude, true 1 | correlation | products |", "|---|--:|--:|--:|--:|--:|"]
    for kind, points, noise in dict.fromkeys((row["kind"], row["points"], row["noise_db"]) for row in rows):
        own = [row for row in rows if (row["kind"], row["points"], row["noise_db"]) == (kind, points, noise)]
        cells = [f"{len(own)} {kind if kind == 'vessels' else 'yarns'}", f"{points:,}"]
        cells.append("none" if noise is None else f"{noise:g} dB")
        for name, digits in (("amplitude", 2), ("correlation", 3), ("products", 0)):
            found = [row[name] for row in own]
            cells.append(f"{np.mean(found):.{digits}f} ({min(found):.{digits}f}–{max(found):.{digits}f})")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def write_page(page: Path, rows: list[Row]) -> None:
    """Replace the table between the markers of a documentation page."""
    replace_between_markers(page, BEGIN, END, table(rows))
