"""Benchmark of the live view: incremental update against a reconstruction from scratch."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from fabry_perot.simulator import phantoms
from steradian.benchmarks.speed_cases import INTERVAL, SPEED, YARN
from steradian.core.progress import Progress
from steradian.imaging import Volume, reconstruct
from steradian.imaging.signal.conditioning import Display
from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.quality import above_threshold, correlation
from steradian.reconstructions.live.follow import LiveReconstruction, Resolution, draw
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.resolve import resolve_setup
from steradian.reconstructions.pipeline.run import reconstruct_in_memory
from steradian.scans.file.read import read_scan
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from steradian.scans.importing.scan_writer import ImportedAline

Row: TypeAlias = dict[str, Any]
Order = Literal["progressive", "snake"]
REVISIONS, LIMIT = 16, 0.4
NOISE = 10 ** (-30 / 20)  # of the largest sample


def live(*, quick: bool = False, revisions: int = REVISIONS, progress: Progress | None = None) -> list[Row]:
    """Measure live-view revisions of the paper's yarn scan (1,605 points, 226² modes, 1,024 samples) in equal parts.

    Parameters
    ----------
    quick
        A small scan: a check that it runs, no measurement.
    revisions
        How many parts the A-lines arrive in; the last image is the full one from the file.
    progress
        Called at each revision.

    Returns
    -------
    list of dict
        One row a detail of the view and an order of visit. ``revision_s``: mean from A-lines in the file to
        projections in picture files; ``full_s``: the same files made from scratch at the full resolution from the
        same points (no volume file, which takes longer still), in turns with the revisions; ``ratio``: their quotient;
        ``ratio_with_last``: with the full reconstruction at the end counted as the last revision, and ``limit``, what
        it must not exceed; ``add_s``,
        ``reconstruct_s``, ``write_s``: parts of a revision; ``last_error``: relative l2 distance of the image grown
        from all A-lines to the one from the file, at the same resolution; ``truth``, ``truth_full``: mean correlation
        of the z-projection of revisions, and of the full images of the same points with the mask's weights scaled, with
        the true one over the pixels of interest.
    """
    rows = []
    cases = [(detail, order) for detail in get_args(Resolution) for order in get_args(Order)]
    with tempfile.TemporaryDirectory() as folder:  # loads the compiled code
        _follow(Path(folder), "full", "snake", True, 2, lambda _: None)
    for number, (detail, order) in enumerate(cases):

        def step(done: int, what: str = f"{detail}, {order}", first: int = number) -> None:
            if progress is not None:
                progress(what, first * revisions + done, len(cases) * revisions)

        with tempfile.TemporaryDirectory() as folder:
            rows.append(_follow(Path(folder), detail, order, quick, revisions, step))
    return rows


def _follow(folder: Path, detail: Resolution, order: Order, quick: bool, revisions: int, step: Any) -> Row:
    plan, traces, scale = _yarn(order, quick)
    scan, parameters = folder / "scan.h5", ReconstructionParameters.create(modes=56 if quick else 226)
    create_scan_file(scan, plan, simulated=True)
    seconds, fulls, alike, parts = [], [], [], []
    truth = _truth(parameters.modes or 0, quick)
    interest = above_threshold(truth)
    with ScanFileWriter(scan) as store:
        view = LiveReconstruction(scan, folder / "live", parameters, detail)
        for done, arrived in enumerate(np.array_split(np.arange(plan.mask.count), revisions)):
            step(done)
            store.append(ImportedAline(int(v), traces[plan.visit[v]], scale, shot=0) for v in arrived)
            begin = time.perf_counter()
            revision = view.update()
            seconds.append(time.perf_counter() - begin)
            begin = time.perf_counter()
            recording = read_scan(scan)
            full = reconstruct_in_memory(recording, parameters)
            views = draw(full, folder / "full", Display(), recording.positions)
            fulls.append(time.perf_counter() - begin)
            assert revision is not None and view.latest is not None  # noqa: PT018
            parts.append(revision.seconds)
            alike.append([correlation(image, truth, interest) for image in (view.latest, views["z"])])
    grown, same = view.volume(), _from_scratch(scan, view, parameters)
    mean, full_mean = float(np.mean(seconds)), float(np.mean(fulls))
    return {
        "detail": detail,
        "order": order,
        "revisions": revisions,
        "shape": "×".join(map(str, grown.values.shape)),
        "revision_s": mean,
        "full_s": full_mean,
        "ratio": mean / full_mean,
        "limit": LIMIT if detail == "preview" else None,
        "ratio_with_last": float(np.mean([*seconds[:-1], fulls[-1]])) / full_mean,
        **{f"{name}_s": float(np.mean([part[name] for part in parts])) for name in ("add", "reconstruct", "write")},
        "last_error": _distance(grown, same),
        "truth": float(np.mean(alike, axis=0)[0]),
        "truth_full": float(np.mean(alike, axis=0)[1]),
    }


def _yarn(order: Order, quick: bool) -> tuple[ScanPlan, NDArray[np.int16], float]:
    """Return the yarn's plan, its A-lines in digitiser counts in the mask's order, and the pressure per count."""
    mask = equi_steradian_mask(YARN, 3.6e-3, 100 if quick else 1600)
    samples = 256 if quick else 1024
    plan = ScanPlan.create(
        mask=mask, samples=samples, sampling_interval=INTERVAL, sound_speed=SPEED, order=order, averages=1
    )
    balls = phantoms.yarn(0)
    pressure = phantoms.pressure(balls, mask.positions, np.arange(samples) * INTERVAL, SPEED)
    peak = float(np.abs(pressure).max())
    noisy = pressure + peak * NOISE * np.random.default_rng(0).standard_normal(pressure.shape)
    scale = float(np.abs(noisy).max()) / 32767
    return plan, np.rint(noisy / scale).astype(np.int16), scale


def _truth(modes: int, quick: bool) -> NDArray[np.float32]:
    """Return the z-projection [x, y] of the true initial pressure."""
    lateral = (np.arange(modes) - modes // 2) * YARN / modes
    depth = np.arange(0, 256 if quick else 1024, 4) * INTERVAL * SPEED
    projection: NDArray[np.float32] = phantoms.initial_pressure(phantoms.yarn(0), lateral, lateral, depth).max(axis=2)
    return projection


def _from_scratch(scan: Path, view: LiveReconstruction, parameters: ReconstructionParameters) -> Volume:
    """Reconstruct a whole scan file at the live view's resolution."""
    recording = read_scan(scan)
    geometry, grid, method, compute = view.preview.apply(resolve_setup(recording, parameters))
    traces = np.multiply(recording.traces, np.asarray(recording.scale)[:, None], dtype=np.float32)
    return reconstruct(geometry.acquisition(view.preview.decimate(traces)), grid, method, compute=compute)


def _distance(a: Volume, b: Volume) -> float:
    return float(np.linalg.norm(a.values - b.values) / np.linalg.norm(b.values))
