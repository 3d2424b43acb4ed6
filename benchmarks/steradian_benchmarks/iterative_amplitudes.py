"""Benchmark of the amplitudes of iterative images of held-out vessels and of yarns, at two levels of noise."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from fabry_perot.simulator.phantoms import Balls
from steradian import phantoms
from steradian.benchmarks.report_pages import replace_between_markers
from steradian.core.progress import Progress
from steradian.imaging import Acquisition, Compute, ImageGrid, Iterative, Volume, reconstruct
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
MOSTLY_VISIBLE = 0.6
"""Share of its waves that reach the aperture, from which on a part of a vessel counts as visible."""
FEWEST = 3  # balls of a part
DIRECTIONS = 360  # of emission in half a circle
LARGEST_GAP = 2.5  # between neighbouring balls of one vessel, in units of s
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
        One row an image: ``kind``, ``points``, ``noise_db``, ``seed``, ``amplitude``, ``correlation``, ``products``;
        the amplitudes of parts of which at least 60 % of the waves reach the aperture (``visible``) and of the others
        (``hidden``; None if there are few), fitted together.
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
    visible, hidden = _parts(balls, image)
    assert image.info is not None
    return {
        "kind": case.kind,
        "points": mask.count,
        "noise_db": case.noise,
        "seed": seed,
        "amplitude": float(np.vdot(truth, image.values) / np.vdot(truth, truth)),
        "correlation": float(correlation(image.values, truth)),
        "products": image.info.products,
        "visible": visible,
        "hidden": hidden,
    }


def visible_share(balls: Balls, side: float) -> NDArray[np.float64]:
    """Return the share of waves of each ball of a tube phantom that reach a square aperture at z = 0.

    A tube emits at right angles to its axis, which is the direction to the next ball; a wave and the one the other way
    count once.

    Parameters
    ----------
    balls
        Balls in their order along the tubes.
    side
        Side of the aperture in m, with its middle at x = y = 0.

    Returns
    -------
    (B,) shares, 0 to 1.
    """
    steps = np.diff(balls.centres, axis=0)
    last = np.append(np.linalg.norm(steps, axis=1) > LARGEST_GAP * balls.sigmas[:-1], True)
    axes = np.append(steps, steps[-1:], axis=0)
    axes[last] = axes[np.maximum(np.flatnonzero(last) - 1, 0)]
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    across = np.cross(axes, np.where(np.abs(axes[:, 2:]) < 0.9, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)))
    across /= np.linalg.norm(across, axis=1)[:, None]
    angles = np.pi * (np.arange(DIRECTIONS) + 0.5) / DIRECTIONS
    waves = np.cos(angles)[:, None] * across[:, None] + np.sin(angles)[:, None] * np.cross(axes, across)[:, None]
    up = np.where(waves[..., 2:] > 0, -waves, waves)
    paths = balls.centres[:, None, 2:] / np.minimum(up[..., 2:], -1e-9)
    places = balls.centres[:, None, :2] - up[..., :2] * paths
    found: NDArray[np.float64] = (np.abs(places) <= side / 2).all(axis=-1).mean(axis=1)
    return found


def _parts(balls: Balls, image: Volume) -> tuple[float, float | None]:
    """Return the amplitudes of visible and hidden parts, fitted together by least squares; None for few balls."""
    is_visible = visible_share(balls, SIDE) >= MOSTLY_VISIBLE
    parts = [
        phantoms.rasterise(Balls(balls.centres[own], balls.sigmas[own], balls.amplitudes[own]), image).values.ravel()
        for own in (is_visible, ~is_visible)
        if own.sum() >= FEWEST
    ]
    basis = np.stack(parts, axis=1).astype(np.float64)
    visible, *hidden = np.linalg.solve(basis.T @ basis, basis.T @ image.values.ravel())
    return float(visible), float(hidden[0]) if hidden else None


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
    lines = [
        "| objects | points | noise | amplitude, true 1 | visible parts | hidden parts | correlation | products |",
        "|---|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for kind, points, noise in dict.fromkeys((row["kind"], row["points"], row["noise_db"]) for row in rows):
        own = [row for row in rows if (row["kind"], row["points"], row["noise_db"]) == (kind, points, noise)]
        cells = [f"{len(own)} {kind if kind == 'vessels' else 'yarns'}", f"{points:,}"]
        cells.append("none" if noise is None else f"{noise:g} dB")
        for name, digits in (("amplitude", 2), ("visible", 2), ("hidden", 2), ("correlation", 3), ("products", 0)):
            found = [row[name] for row in own if row[name] is not None]
            if not found:
                cells.append("none")
                continue
            cells.append(f"{np.mean(found):.{digits}f} ({min(found):.{digits}f}–{max(found):.{digits}f})")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def write_page(page: Path, rows: list[Row]) -> None:
    """Replace the table between the markers of a documentation page."""
    replace_between_markers(page, BEGIN, END, table(rows))
