"""Live reconstruction that updates the image of a running scan.

A revision adds the A-lines stored since the last one to the running sum (:mod:`steradian.imaging.incremental`), makes
an image of the points so far and replaces ``mip-*.png``, ``projections.h5`` and ``revision.json``. When the scan is
over the last revision is the full reconstruction from the file, by the same code and with the same files as
:func:`steradian.reconstructions.pipeline.run.reconstruct_scan`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import Cancelled, InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.imaging import DirectMethod, ReconstructionPlan, Volume
from steradian.imaging.incremental import IncrementalReconstruction
from steradian.imaging.signal.conditioning import Conditioning, Display
from steradian.reconstructions.live.preview import CoarseParameters, choose_preview
from steradian.reconstructions.live.revision_metrics import Revision, quality_of
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.report import Report
from steradian.reconstructions.pipeline.resolve import modes_of, request_field_names, resolve_setup
from steradian.reconstructions.pipeline.run import reconstruct_scan, write_json
from steradian.reconstructions.pipeline.sensor_gaps import largest_gap
from steradian.reconstructions.shot_normalisation import normalise_new_shots
from steradian.reconstructions.volumes.file import write_projections
from steradian.reconstructions.volumes.near_field import crop_depth, near_field_depth
from steradian.reconstructions.volumes.projections import Projections, project, project_below_depth
from steradian.reconstructions.volumes.reader import VolumeReader
from steradian.scans.file.tail import AlineBatch, ScanExtended, ScanTail, has_alines
from steradian.scans.opening import FIRST
from steradian.scans.recording import Recording

Resolution = Literal["preview", "full"]
ACCUMULATED_METHODS = ("nedner", "ner", "linear", "nearest")
"""Methods whose image is a sum over sensors."""
MAX_BATCH = 4096
"""A-lines read and added together: bounds the memory when a view begins late."""
LONGEST_WAIT = 0.2
"""Seconds between two looks at whether the scan is over or the view is cancelled."""


def reconstruct_live(
    scan: Path,
    output: Path,
    parameters: ReconstructionParameters | None = None,
    *,
    is_over: Callable[[], bool],
    interval: float = 2.0,
    detail: Resolution = "preview",
    frame: int = 0,
    revised: Callable[[Revision], None] | None = None,
    wait: Callable[[float], None] = time.sleep,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> Report:
    """Reconstruct a running scan in coarse revisions, and at full resolution when the scan is over.

    Parameters
    ----------
    scan
        The scan file; it need not exist yet.
    output
        Folder for the results; each file in it is replaced whole.
    parameters
        Of the full reconstruction; the revisions before use the same but for their coarser voxels.
    is_over
        Whether nothing more will be stored; asked before each look at the file.
    interval
        Seconds between the beginnings of two revisions, if the first takes no longer.
    detail
        ``preview``: voxels of at least the lateral spacing in depth, at most a quarter of the full image's number;
        ``full``: the full image's voxels.
    frame
        Which frame of the scan.
    revised
        Called after each revision.
    wait
        How to wait some seconds.
    progress
        Called with the stage "A-lines" at each look, then with the stages of the full reconstruction.
    cancelled
        Asked between pieces of work and while waiting.

    Returns
    -------
    Report
        Of the full reconstruction.

    Raises
    ------
    NotFound, DamagedFile
        When the scan is over and its file cannot be read or holds no A-line.
    InvalidInput
        When a parameter does not fit the scan, the method's image is no sum over sensors, or bad A-lines are to be
        treated, which takes all A-lines.
    Cancelled
        When ``cancelled`` said so; the files are those of the last revision.
    """
    if not interval >= 0:
        raise InvalidInput("interval", interval, "0 or more (s)")
    chosen = parameters or ReconstructionParameters()
    if chosen.method not in ACCUMULATED_METHODS:
        raise InvalidInput(
            "method", chosen.method, f"{', '.join(ACCUMULATED_METHODS)}: sums over sensors, which can grow"
        )
    if chosen.shots.bad_lines != "keep":
        raise InvalidInput("shots.bad_lines", chosen.shots.bad_lines, "keep while a scan is followed")
    if chosen.lossy:
        raise InvalidInput("medium", "with attenuation", "one without attenuation while a scan is followed")
    view: LiveReconstruction | None = None
    seen = 0, 1
    while not is_over():
        began = time.monotonic()
        if view is None and has_alines(scan, frame):
            view = LiveReconstruction(scan, output, chosen, detail, frame)
        revision = view.update(cancelled=cancelled) if view else None
        if revision:
            seen = revision.points, revision.planned
        if progress:
            progress("A-lines", *seen)
        if revision and revised:
            revised(revision)
        _wait(interval - (time.monotonic() - began), is_over, wait, cancelled)
    began = time.monotonic()
    report = reconstruct_scan(scan, output, chosen, frame=frame or FIRST, progress=progress, cancelled=cancelled)
    last = _final_revision(output, report, view, time.monotonic() - began)
    if revised:
        revised(last)
    return report


class LiveReconstruction:
    """Incremental coarse reconstruction of a scan, updated with newly stored A-lines.

    Parameters
    ----------
    scan
        A scan file, being filled or not.
    output, parameters, detail, frame
        As in :func:`reconstruct_live`.

    Attributes
    ----------
    preview
        Coarse parameters of the revisions.
    number
        Number of the latest revision, 0 before the first.
    latest
        z-projection [x, y] of the latest revision; for a line of sensors the image [x, z].
    """

    def __init__(
        self,
        scan: Path,
        output: Path,
        parameters: ReconstructionParameters,
        detail: Resolution = "preview",
        frame: int = 0,
    ) -> None:
        self.parameters, self.output = parameters, output
        self._scan, self._detail, self._frame = scan, detail, frame
        self.latest: NDArray[Any] | None = None
        self.number = 0
        self.coverage: dict[str, float] = {}
        self._open()

    def _open(self) -> None:
        """Open the scan file, and plan the reconstruction of all its points."""
        parameters = self.parameters
        self._follower = ScanTail(self._scan, self._frame)
        whole = self._follower.whole
        full, modes = resolve_setup(whole, parameters), modes_of(whole, parameters)
        step = full.geometry.dt * full.geometry.sound_speed
        coarse = choose_preview(modes, full.geometry.samples, whole.aperture / modes, step)
        self.preview = coarse if self._detail == "preview" else CoarseParameters(modes, 1)
        with request_field_names():
            geometry, grid, method, compute = self.preview.apply(full)
            assert isinstance(method, DirectMethod)  # noqa: S101 - of an image that is a sum over sensors
            plan = ReconstructionPlan(geometry, grid, method, compute=replace(compute, device="cpu"))
        self._growing = IncrementalReconstruction(plan)

    @property
    def points(self) -> int:
        """Number of points in the image so far."""
        return int(self._growing.measured.sum())

    @property
    def whole(self) -> Recording:
        """Recording with all planned points of the scan and no signal, for geometry and weights."""
        return self._follower.whole

    def volume(self) -> Volume:
        """Return the image reconstructed from the A-lines so far."""
        return self._growing.volume()

    def update(self, *, cancelled: CancelCheck | None = None) -> Revision | None:
        """Update the image with newly stored A-lines and return the new revision; ``None`` without new A-lines.

        A scan that has got a further stage is taken anew, with all its A-lines.
        """
        clock = Clock()
        if not self.add_new(clock, cancelled):
            return None
        with clock("reconstruct"):
            volume = self._growing.volume(cancelled=cancelled)
        with clock("write"):
            views = draw(volume, self.output, self.parameters.display, self._follower.whole.positions)
            write_projections(self.output / "projections.h5", volume, views)
        revision = self._revision(views, volume, clock.seconds)
        write_json(self.output / "revision.json", revision)
        return revision

    def add_new(self, clock: Clock | None = None, cancelled: CancelCheck | None = None) -> int:
        """Add newly stored A-lines to the incremental reconstruction and return their number."""
        try:
            return self._add_new(clock or Clock(), cancelled)
        except ScanExtended:
            self._open()
            return self._add_new(clock or Clock(), cancelled)

    def _add_new(self, clock: Clock, cancelled: CancelCheck | None) -> int:
        # what all A-lines have in common changes with each of them: then they are taken anew, and all at once
        common = self.parameters.conditioning.remove_common is not None
        count = 0
        while True:
            with clock("read"):
                new = self._follower.read_new(None if common else MAX_BATCH)
                if common and len(new.points):
                    self._follower.rewind()
                    new = replace(self._follower.read_new(), replaced=True)
            if new.replaced:
                self._growing.clear()
            if not len(new.points):
                return count
            new = normalise_new_shots(new, self.whole, self.parameters.shots)
            if len(new.points):
                with clock("add"):
                    self._growing.add(new.points, self.preview.decimate(self._conditioned(new)), cancelled=cancelled)
            count += len(new.points)
            if common:
                return count

    def _conditioned(self, new: AlineBatch) -> NDArray[np.float32]:
        conditioning, whole = self.parameters.conditioning, self.whole
        if conditioning == Conditioning():
            return new.traces
        return conditioning.apply(
            new.traces, whole.positions[new.points], sampling_interval=whole.sampling_interval, aperture=whole.aperture
        )

    def _revision(self, views: Projections, volume: Volume, seconds: dict[str, float]) -> Revision:
        began = time.perf_counter()
        growing, whole = self._growing, self.whole
        self.number += 1
        image = views.get("z", views["y"])  # of a line there is the image only
        quality = quality_of(image, self.latest)
        self.latest = image
        points = int(growing.measured.sum())
        self.coverage = {
            "points": points / whole.planned,
            "area": growing.covered_fraction,
            "largest_gap_m": largest_gap(whole.positions[growing.measured], whole.aperture),
        }
        seconds = seconds | {"judge": time.perf_counter() - began}
        return Revision(
            number=self.number,
            points=points,
            planned=whole.planned,
            coverage=self.coverage,
            quality=quality,
            image={"shape": volume.values.shape, "spacing_m": volume.spacing, **asdict(self.preview)},
            weights=f"{self.parameters.weights} weights of the whole plan, fitted to the points so far",
            seconds={name: round(value, 4) for name, value in (seconds | {"total": sum(seconds.values())}).items()},
        )

    def quality_against_previous(self, image: NDArray[Any]) -> dict[str, float | None]:
        """Return quality metrics of an image, with its correlation to the latest revision if the shapes agree."""
        same = self.latest is not None and self.latest.shape == image.shape
        return quality_of(image, self.latest if same else None)


def _final_revision(output: Path, report: Report, view: LiveReconstruction | None, seconds: float) -> Revision:
    """Write ``revision.json`` for the full reconstruction at the end of the scan."""
    coverage = {"points": report.sensors / report.planned}
    if report.sensors == report.planned:
        coverage["area"] = 1.0
    elif view and view.coverage.get("points") == coverage["points"]:  # nothing came after the last look
        coverage = view.coverage
    revision = Revision(
        number=(view.number if view else 0) + 1,
        points=report.sensors,
        planned=report.planned,
        final=True,
        coverage=coverage,
        image={"shape": report.shape, "spacing_m": report.spacing_m, "decimation": 1},
        weights=f"{report.parameters['weights']} of the points measured",
        seconds=report.seconds | {"total": round(seconds, 4)},
    )
    image = _read_projection(output / "volume.h5", report.near_field_m)
    revision.quality = view.quality_against_previous(image) if view else quality_of(image, None)
    write_json(output / "revision.json", revision)
    (output / "projections.h5").unlink(missing_ok=True)  # the volume has its own
    return revision


def _read_projection(path: Path, near: float) -> NDArray[Any]:
    """Read the z-projection below the near field from a volume file; for a 2-D image, the image itself."""
    stored = VolumeReader(path)
    if len(stored.lattice.shape) == 2:
        return stored.projection("y")
    count = stored.lattice.shape[2]
    first = min(math.ceil((near - stored.lattice.origin[2]) / stored.lattice.spacing[2] - 1e-6), count - 1)
    return stored.slab_mip("z", range(first, count)) if first > 0 else stored.projection("z")


def draw(volume: Volume, output: Path, display: Display, positions: NDArray[np.float64] | None = None) -> Projections:
    """Draw the projections of a volume as PNG files, and return the projections of the unprocessed volume.

    Those along x and y are of all depths, that along z is from the near field on, as its picture.

    The near field is found with the ``positions`` of the sensors, where ``display`` does not say it.
    """
    from steradian.reconstructions.volumes.images import draw_projection

    near = display.near_field
    if near is None:
        near = 0.0 if positions is None else near_field_depth(volume, positions)
    beyond, everything = project_below_depth(volume, near)
    volume = crop_depth(volume, near)
    shown = beyond
    if display.changes_values:
        volume = display.apply(volume)
        shown = project(volume)
    output.mkdir(parents=True, exist_ok=True)
    for axis, image in shown.items():
        draw_projection(image, volume, axis, output / f"mip-{axis}.png", display)
    return everything | {axis: image for axis, image in beyond.items() if axis == "z"}


def _wait(
    seconds: float, is_over: Callable[[], bool], wait: Callable[[float], None], cancelled: CancelCheck | None
) -> None:
    """Wait for a time in seconds, but at most until the scan is over; raise ``Cancelled`` on cancellation."""
    while True:
        if cancelled and cancelled():
            raise Cancelled("the live view was stopped; its last revision is stored")
        if seconds <= 0 or is_over():
            return
        wait(min(seconds, LONGEST_WAIT))
        seconds -= LONGEST_WAIT


class Clock:
    """Timer that sums the wall time of named stages."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Context manager that adds the wall time of its block to a stage."""
        began = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - began
