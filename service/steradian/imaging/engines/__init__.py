"""Compute engines: implementations of the three transform steps and their adjoints.

An engine makes an image of A-lines in three steps, and A-lines of an image in their transposes (of
transposable tables). What it hands from step to step is its own.

    traces ── lateral ──► modes over time ── to_depth ──► modes over depth ── to_image ──► image
    traces ◄── lateral_adjoint ── modes over time ◄── to_depth_adjoint ── modes over depth ◄── to_image_adjoint ── image

:mod:`.numba` is the one that reconstructions use; :mod:`.array` says the same in whole arrays, for reading, for being
compared with, and for arrays of other libraries.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple, Protocol

from numpy.typing import NDArray

from steradian.core.progress import CancelCheck, Progress
from steradian.imaging.transform_tables import TransformTables
from steradian.imaging.transforms.lateral import LateralTransform
from steradian.imaging.volume import RealArray


class ProgressMonitor(NamedTuple):
    """Progress and cancellation callbacks (:mod:`steradian.core.progress`)."""

    progress: Progress | None = None
    cancelled: CancelCheck | None = None

    def of_layer(self, number: int, layers: int) -> ProgressMonitor:
        """Return the callbacks for one of several layers, which stages name."""
        if self.progress is None:
            return self
        return self._replace(progress=partial(_layer_progress, self.progress, number, layers))


def _layer_progress(progress: Progress, number: int, layers: int, stage: str, done: int, total: int) -> None:
    progress(f"layer {number} of {layers}: {stage}", done, total)


NO_MONITOR = ProgressMonitor()


class Engine(Protocol):
    """Protocol of compute engines: three transform steps and their adjoints, all of which may raise ``Cancelled``."""

    @property
    def tables(self) -> TransformTables:
        """Tables for which the engine was created."""

    def lateral(
        self,
        traces: Any,
        watch: ProgressMonitor = ...,
        *,
        scale: float = 1.0,
        sensors: NDArray[Any] | None = None,
        onto: Any = None,
    ) -> Any:
        """Return the lateral modes over time of traces (M, N_t), times ``scale``.

        ``sensors`` (K,) are the numbers of those whose traces (K, N_t) are given, None all. ``onto`` are modes that
        these are added to; they are changed.
        """

    def to_depth(self, modes: Any, watch: ProgressMonitor = ..., *, kept: bool = False) -> Any:
        """Return the modes over depth of modes over time, which are overwritten unless ``kept``."""

    def to_image(self, modes: Any, watch: ProgressMonitor = ...) -> RealArray:
        """Return the image [x, y, z] ([x, z] in 2-D) of modes over depth, which are overwritten."""

    def lateral_adjoint(self, modes: Any, watch: ProgressMonitor = ..., *, kept: bool = False) -> RealArray:
        """Return the traces (M, N_t) of modes over time, which may be overwritten unless ``kept``.

        The adjoint of :meth:`lateral`.
        """

    def to_depth_adjoint(self, modes: Any, watch: ProgressMonitor = ...) -> Any:
        """Return the modes over time of modes over depth, which are overwritten."""

    def to_image_adjoint(self, image: Any, watch: ProgressMonitor = ...) -> Any:
        """Return the modes over depth of an image: the adjoint of :meth:`to_image`."""

    def with_sensors(self, lateral: LateralTransform) -> Engine:
        """Return an engine with other sensors, whose modes over time are interchangeable with this one's."""


def run_inverse(engine: Engine, traces: Any, watch: ProgressMonitor = NO_MONITOR, *, scale: float = 1.0) -> RealArray:
    """Compute the image of traces with an engine: the inversion, or the adjoint of the forward model."""
    return engine.to_image(engine.to_depth(engine.lateral(traces, watch, scale=scale), watch), watch)


def run_forward(engine: Engine, image: Any, watch: ProgressMonitor = NO_MONITOR) -> RealArray:
    """Compute the A-lines of an image with an engine, by the tables of the forward model."""
    return engine.lateral_adjoint(engine.to_depth_adjoint(engine.to_image_adjoint(image, watch), watch), watch)
