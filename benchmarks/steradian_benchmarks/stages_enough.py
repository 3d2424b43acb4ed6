"""Benchmark of the stopping rule: yarns scanned until the rule ends the scan, beside the whole scan."""

from __future__ import annotations

from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.comparisons import phantom
from steradian.core.progress import Progress
from steradian.imaging import (
    Acquisition,
    AcquisitionGeometry,
    Compute,
    ImageGrid,
    Iterative,
    Method,
    Nufft,
    ReconstructionPlan,
    Volume,
    reconstruct,
)
from steradian.imaging.geometry.voronoi import voronoi_cell_areas
from steradian.imaging.incremental import IncrementalReconstruction
from steradian.masks import Mask, equi_steradian_mask
from steradian.masks.weights import resolve_outline
from steradian.phantoms import add_noise, pressure, rasterise
from steradian.plans import ScanPlan, VisitOrder
from steradian.quality import correlation, disc
from steradian.quality.stopping_rule import RevisionImage, StopDecision, StoppingRule, decide

APERTURE, POINT, REGION = 13.56e-3, (0.0, 0.0, 3.6e-3), 7.2e-3
INTERVAL, SPEED, NOISE = 16e-9, 1500.0, 30.0
COUNTS, YARNS = (1600, 3200, 800), 5
LIVE_MODES, LIVE_DEPTH = 113, (1e-3, 8e-3)
"""Voxels of the growing image, beyond the near field."""
MODES, ITERATIONS = 136, 20
FIRST_PART, PARTS = 8, 32
"""Revisions are made after each 1/32 of the points, from a quarter on."""
LEAST_SAVED, MOST_LOST = 0.25, 0.005
CPU = Compute(device="cpu")
Row = dict[str, Any]


def enough(*, quick: bool = False, progress: Progress | None = None) -> list[Row]:
    """Scan yarns in progressive order until the stopping rule ends the scan.

    Parameters
    ----------
    quick
        One yarn through 300 points, directly reconstructed only.
    progress
        Called after each yarn.

    Returns
    -------
    list of dict
        One row a yarn and number of points: points at the stop, expected and actual change of the growing image, and
        the loss of correlation of the final images beside those of the whole scan (``direct_loss`` of the z-projection,
        ``iterative_loss`` of the volume).
    """
    cases = [(count, seed) for count in ((300,) if quick else COUNTS) for seed in range(1 if quick else YARNS)]
    rows = []
    for done, (count, seed) in enumerate(cases):
        rows.append(_case(count, seed, iterations=0 if quick else ITERATIONS))
        if progress:
            progress("yarns", done + 1, len(cases))
    return rows


def _case(count: int, seed: int, *, iterations: int) -> Row:
    """Return the row of one yarn."""
    mask, yarn = equi_steradian_mask(APERTURE, POINT[2], count), phantom("yarn", POINT, seed=seed)
    samples = ceil(np.hypot(APERTURE, LIVE_DEPTH[1]) / SPEED / INTERVAL)
    clean = pressure(yarn, mask.positions, samples=samples, sampling_interval=INTERVAL, sound_speed=SPEED)
    traces = add_noise(clean, NOISE, seed=seed)
    visit = ScanPlan.create(mask=mask, order=VisitOrder.PROGRESSIVE).visit
    decision, points, change = _scan(mask, traces, visit)
    reach = 3 * float(yarn.sigmas.max())
    depths = float(yarn.centres[:, 2].min()) - reach, float(yarn.centres[:, 2].max()) + reach
    row: Row = {"part": "enough", "points": mask.count, "seed": seed}
    row |= {"stopped_at": points, "share": points / mask.count}
    row |= {"reason": decision.reason, "expected_gain": decision.gain}
    row |= {"expected_change": decision.change, "actual_change": change}
    methods: dict[str, Method] = {"direct": Nufft(tolerance=1e-3)}
    if iterations:
        methods["iterative"] = Iterative(iterations=iterations)
    for name, method in methods.items():
        images = [_image(mask, traces, np.sort(visit[:end]), depths, method) for end in (points, mask.count)]
        truth = rasterise(yarn, images[0])
        ended, whole = (_correlation(image, truth, flat=name == "direct") for image in images)
        row |= {name: ended, f"{name}_whole": whole, f"{name}_loss": whole - ended}
    return row


def _scan(mask: Mask, traces: NDArray[np.float32], visit: NDArray[np.int64]) -> tuple[StopDecision, int, float]:
    """Return the decision that ended the scan, the number of points and the real change by the rest."""
    geometry = AcquisitionGeometry(mask, traces.shape[1], dt=INTERVAL, sound_speed=SPEED)
    plan = ReconstructionPlan(geometry, ImageGrid(LIVE_MODES, depth=LIVE_DEPTH), Nufft(tolerance=1e-3), compute=CPU)
    growing, rule = IncrementalReconstruction(plan), StoppingRule()
    revisions: list[RevisionImage] = []
    ended: tuple[StopDecision, RevisionImage] | None = None
    done = 0
    for part in range(FIRST_PART, PARTS + 1):
        points = part * mask.count // PARTS
        growing.add(visit[done:points], traces[visit[done:points]])
        done = points
        if ended is None or part == PARTS:
            revisions.append(RevisionImage(points, growing.volume().mip("z")))
        if ended is None and (decision := decide(rule, revisions, mask.count)).stop:
            ended = decision, revisions[-1]
    assert ended is not None
    return ended[0], ended[1].points, 1 - correlation(ended[1].image, revisions[-1].image)


def violations(rows: list[Row]) -> list[str]:
    """Return one line for each claim about 1,600 points that does not hold."""
    own = [row for row in rows if abs(row["points"] - COUNTS[0]) < 10]
    if not own:
        return []
    lines = []
    saved = 1 - float(np.mean([row["share"] for row in own]))
    if saved < LEAST_SAVED:
        lines.append(f"pulses saved: {saved:.1%}, below {LEAST_SAVED:.0%}")
    for name in ("direct_loss", "iterative_loss"):
        worst = max(row[name] for row in own)
        if worst > MOST_LOST:
            lines.append(f"{name}: {worst:.4f}, above {MOST_LOST}")
    return lines


def _image(
    mask: Mask, traces: NDArray[np.float32], points: NDArray[np.int64], depths: tuple[float, float], method: Method
) -> Volume:
    acquisition = Acquisition(
        traces[points],
        mask.positions[points],
        dt=INTERVAL,
        sound_speed=SPEED,
        aperture=mask.aperture,
        weights=voronoi_cell_areas(mask.positions[points], resolve_outline(mask)),
    )
    return reconstruct(acquisition, ImageGrid(MODES, depth=depths), method, compute=CPU)


def _correlation(image: Volume, truth: Volume, *, flat: bool) -> float:
    """Return the correlation with the object around the point of interest, of z-projections or of volumes."""
    near = disc(image.coordinates("x"), image.coordinates("y"), REGION, POINT[:2])
    if flat:
        return correlation(image.mip("z"), truth.mip("z"), near)
    return correlation(image.values, truth.values, np.broadcast_to(near[..., None], image.values.shape))
