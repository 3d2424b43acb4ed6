"""The function :func:`reconstruct`: reconstruction in one call, without a separate plan."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeAlias

from steradian.core.exceptions import InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.imaging.acquisition import Acquisition
from steradian.imaging.engines.array_namespace import to_numpy
from steradian.imaging.iterative_options import Iterative
from steradian.imaging.options import Compute, DirectMethod, ImageGrid, Nufft, require_direct
from steradian.imaging.plan import ReconstructionPlan
from steradian.imaging.signal.bandwidth import resolve_upper_frequency
from steradian.imaging.volume import Volume

Method: TypeAlias = DirectMethod | Iterative


def reconstruct(
    acquisition: Acquisition,
    grid: ImageGrid,
    method: Method = Nufft(),
    *,
    start: Volume | None = None,
    compute: Compute = Compute(),
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> Volume:
    """Reconstruct initial pressure from A-lines recorded at points of a plane (3-D) or of a line (2-D).

    Parameters
    ----------
    acquisition
        A-lines (M, N_t) with sensors and timing.
    grid
        Voxels of the image.
    method
        :class:`Nufft`, :class:`Ner`, :class:`LinearKappa`, :class:`NearestKappa`, :class:`Gridded` or
        :class:`Iterative`, with its options.
    start
        For :class:`Iterative`: image on the same voxels at which it begins, such as the frame before. None: zero.
    compute
        Execution options.
    progress, cancelled
        See :mod:`steradian.core.progress`.

    Returns
    -------
    Volume
        Indexed [x, y, z] ([x, z] in 2-D). Its ``info`` has method, device, band and, for :class:`Iterative`,
        iterations, residuals and the stop reason.

    Raises
    ------
    InvalidInput
        If a parameter is out of range, or the image does not fit into the memory.
    Cancelled
        If ``cancelled`` returned true.
    """
    if isinstance(method, Iterative):
        from steradian.imaging.iterative.solve import solve

        return solve(acquisition, grid, method, start=start, compute=compute, progress=progress, cancelled=cancelled)
    require_direct(method, ", Iterative")
    if start is not None:
        raise InvalidInput("start", "a volume", f"None with the method {method.name}, which does not iterate")
    plan = direct_plan(acquisition, grid, method, compute)
    volume = plan.run(acquisition.traces, scale=acquisition.scale, progress=progress, cancelled=cancelled)
    assert isinstance(volume, Volume)  # noqa: S101 - one set of traces
    return volume


def direct_plan(
    acquisition: Acquisition, grid: ImageGrid, method: DirectMethod, compute: Compute
) -> ReconstructionPlan:
    """Return the plan of a direct method, with the end of the A-lines' band where the method asks for it."""
    if method.max_frequency == "signal":
        traces = to_numpy(acquisition.traces)
        method = replace(method, max_frequency=resolve_upper_frequency("signal", traces, acquisition.dt))
    return ReconstructionPlan(acquisition.geometry, grid, method, compute=compute)
