"""Compute engines: implementations of the three transform steps and their adjoints.

An engine makes an image of A-lines in three steps, and A-lines of an image in their transposes (of tables of the model,
whose waves go both ways). What it hands from step to step is its own.

    traces ── lateral ──► modes over time ── to_depth ──► modes over depth ── to_image ──► image
    traces ◄── lateral_adjoint ── modes over time ◄── to_depth_adjoint ── modes over depth ◄── to_image_adjoint ── image

:mod:`.numba` is the one that reconstructions use; :mod:`.array` says the same in whole arrays, for reading, for being
compared with, and for arrays of other libraries.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

from numpy.typing import NDArray

from steradian.core.progress import CancelCheck, Progress
from steradian.imaging.tables import TransformTables
from steradian.imaging.volume import RealArray


class ProgressMonitor(NamedTuple):
    """Progress and cancellation callbacks; see :mod:`steradian.core.progress`."""

    progress: Progress | None = None
    cancelled: CancelCheck | None = None


NO_MONITOR = ProgressMonitor()


class Engine(Protocol):
    """The three steps and their transposes. All may raise ``Cancelled``."""

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
        """Modes over time of traces (M, N_t), times ``scale``.

        ``sensors`` (K,) are the numbers of those whose traces (K, N_t) are given, None all. ``onto`` are modes that
        these are added to; they are changed.
        """

    def to_depth(self, modes: Any, watch: ProgressMonitor = ..., *, kept: bool = False) -> Any:
        """Modes over depth of modes over time, which are used up unless they are to be ``kept``."""

    def to_image(self, modes: Any, watch: ProgressMonitor = ...) -> RealArray:
        """Image [x, y, z] ([x, z] in 2-D) of modes over depth, which are used up."""

    def lateral_adjoint(self, modes: Any, watch: ProgressMonitor = ...) -> RealArray:
        """Traces (M, N_t) of modes over time."""

    def to_depth_adjoint(self, modes: Any, watch: ProgressMonitor = ...) -> Any:
        """Modes over time of modes over depth, which are used up."""

    def to_image_adjoint(self, image: Any, watch: ProgressMonitor = ...) -> Any:
        """Modes over depth of an image."""


def run_inverse(engine: Engine, traces: Any, watch: ProgressMonitor = NO_MONITOR, *, scale: float = 1.0) -> RealArray:
    """Make the image of traces: the inversion, or the adjoint of the model."""
    return engine.to_image(engine.to_depth(engine.lateral(traces, watch, scale=scale), watch), watch)


def run_forward(engine: Engine, image: Any, watch: ProgressMonitor = NO_MONITOR) -> RealArray:
    """Make the A-lines of an image, by tables of the model."""
    return engine.lateral_adjoint(engine.to_depth_adjoint(engine.to_image_adjoint(image, watch), watch), watch)
