"""CUDA engine: lateral NUFFT, interpolation at κ, and FFTs of the whole volume on a GPU.

A-lines are transformed over time first, all at once; each frequency is then spread onto the lateral grid and
transformed there. So the interpolation at κ reads what lies side by side, for the modes (±jx, ±jy) with one stencil,
and what is left is the inverse transform of the image. Modes over time are those over its frequencies here, [x, y, f],
on the lines of the grid, and modes over depth those over its frequencies l ≥ 0, [x, y, l]: the image is real.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.imaging.compute import memory_limit as memory
from steradian.imaging.engines import NO_MONITOR, ProgressMonitor
from steradian.imaging.engines.cuda.array_backend import Backend, device
from steradian.imaging.engines.cuda.device_tables import (
    all_orbits,
    axis_of,
    frequencies,
    kappa_map,
    matrix,
    orbit_slice,
    sparse,
)
from steradian.imaging.engines.cuda.fft import (
    image_in_chunks,
    image_of_spectrum,
    lateral_axes,
    run_chunks,
    spectrum_in_chunks,
    spectrum_of_image,
)
from steradian.imaging.engines.cuda.kernel_args import DecimationArgs, Sparse
from steradian.imaging.engines.cuda.memory_plan import MAX_FREE_FRACTION, MemoryPlan, plan_memory
from steradian.imaging.transform_tables import TransformTables
from steradian.imaging.transforms.lateral import LateralTransform
from steradian.imaging.validation import MAX_EXPONENT, describe_non_finite

if TYPE_CHECKING:
    from steradian.imaging.engines import Engine


class CudaEngine:
    """:class:`~steradian.imaging.engines.Engine` on a CUDA device; its results are device arrays.

    Parameters
    ----------
    tables
        What to compute.
    backend
        The device; None: the current one.
    device_memory
        Bytes of it that may be taken; None: nine tenths of what is free. Where a volume needs more, its modes and
        itself are kept on the host, and brought to the device in pieces.
    memory_limit
        See :func:`steradian.imaging.compute.memory_limit.check_memory`.

    Attributes
    ----------
    tables
        As given.
    backend
        The device.
    room
        Memory, and the pieces.

    Raises
    ------
    InvalidInput
        If there is no device, or memory of device or host does not suffice.
    """

    def __init__(
        self,
        tables: TransformTables,
        *,
        backend: Backend | None = None,
        device_memory: int | None = None,
        memory_limit: int | None = None,
    ) -> None:
        from steradian.imaging.engines.cuda.kernels import kernels

        self.tables, self.backend = tables, backend or device()
        self._kernels, self._found = kernels(tables.dtype), frequencies(tables)
        self._axes = axis_of(tables, 0), axis_of(tables, 1)
        limit = int(MAX_FREE_FRACTION * self.backend.free()) if device_memory is None else device_memory
        self.room: MemoryPlan = plan_memory(tables, self._axes, self._found, limit)
        memory.check_memory(self.room.memory_bytes, memory_limit, tables.geometry.shape)
        self._real, self._complex = _dtypes(tables.dtype)
        self._host = matrix(tables.lateral)
        self._onto = self._sent(sparse(self._host, tables.dtype))
        self._from: Sparse | None = None
        self._orbits = self._sent(all_orbits(*self._axes)) if self.room.fits_in_one_pass else None
        self._rule = self._sent(kappa_map(tables, self._found))
        self._window, self._scale = self.array(tables.time.divided), self.array(tables.lateral.scale)
        self._places, self._cells = (
            self.backend.array(self._found.half_spectrum_indices),
            self.backend.array(self._found.full_spectrum_indices),
        )

    def array(self, values: Any) -> Any:
        """Copy A-lines or an image to the device, in the working precision (:meth:`Backend.array`)."""
        return self.backend.array(values, self.tables.dtype)

    def host(self, values: Any) -> NDArray[Any]:
        """Copy a result from the device to the host."""
        return self.backend.host(values)

    def lateral(
        self,
        traces: Any,
        watch: ProgressMonitor = NO_MONITOR,
        *,
        scale: float = 1.0,
        sensors: NDArray[Any] | None = None,
        onto: Any = None,
    ) -> Any:
        """Return the lateral modes of traces on the device (NUFFT type 1)."""
        xp, f, (gx, gy) = self.backend.xp, self._found, self.tables.lateral.grid
        spectra = self._spectra(traces, scale, sensors)
        lines = [axis.used for axis in self._axes]
        kept = None if self.room.fits_in_one_pass else np.empty((len(lines[0]), len(lines[1]), f.count), self._complex)
        each = self.room.frequencies
        made = []

        def work(piece: int) -> None:
            part = spectra if kept is None else xp.ascontiguousarray(spectra[:, piece * each : (piece + 1) * each])
            grid = xp.empty((gx * gy, part.shape[1]), self._complex)
            self.backend.launch(self._kernels.combine, grid.shape[::-1], part, self._onto, grid)
            modes = self.backend.fft.fftn(grid.reshape(gx, gy, -1), axes=lateral_axes(gx), overwrite_x=True)
            if kept is None:
                made.append(xp.ascontiguousarray(modes))
            else:
                some = xp.take(xp.take(modes, self.backend.array(lines[0]), 0), self.backend.array(lines[1]), 1)
                kept[:, :, piece * each : (piece + 1) * each] = self.backend.host(some)

        run_chunks("lateral transform", -(-f.count // each), work, watch)
        modes = made[0] if kept is None else kept
        if onto is not None:
            onto += modes
        return modes if onto is None else onto

    def to_depth(self, modes: Any, watch: ProgressMonitor = NO_MONITOR, *, kept: bool = False) -> Any:
        """Return the modes over depth, by interpolation at κ on the device."""
        xp, half = self.backend.xp, self.tables.geometry.depth_points // 2 + 1
        shape, each = (*self.tables.lateral.modes, half), self.room.orbits
        target = (xp if self.room.fits_in_one_pass else np).empty(shape, self._complex)

        def work(piece: int) -> None:
            source, result, orbits = modes, target, self._orbits
            where: Any = None
            if orbits is None:
                orbits, lines, where = orbit_slice(*self._axes, piece * each, (piece + 1) * each)
                source, result = self.backend.array(modes[lines]), xp.empty((len(where), *shape[1:]), self._complex)
                orbits = self._sent(orbits)
            size = half, len(orbits.squares_x) * len(orbits.squares_y)
            self.backend.launch(self._kernels.to_depth, size, source, orbits, self._rule, result)
            if where is not None:
                target[where] = self.backend.host(result)

        run_chunks("time to depth", -(-(shape[0] // 2 + 1) // each), work, watch)
        return target

    def to_image(self, modes: Any, watch: ProgressMonitor = NO_MONITOR) -> Any:
        """Return the image of modes over depth, by inverse FFT on the device."""
        if not self.room.fits_in_one_pass:
            return image_in_chunks(self.tables, self.backend, self.room, modes, watch)
        made = []
        run_chunks("image", 1, lambda _: made.append(image_of_spectrum(self.tables, self.backend, modes)), watch)
        return made[0]

    def lateral_adjoint(self, modes: Any, watch: ProgressMonitor = NO_MONITOR, *, kept: bool = False) -> Any:
        """Return the traces of lateral modes (NUFFT type 2)."""
        xp, f, (gx, gy) = self.backend.xp, self._found, self.tables.lateral.grid
        if self._from is None:
            self._from = self._sent(sparse(self._host.T, self.tables.dtype))
        spectra = xp.zeros((len(self._scale), f.length), self._complex)
        cells, each = self._cells, self.room.frequencies
        x, y = (self.backend.array(axis.used) for axis in self._axes)

        def work(piece: int) -> None:
            grid = modes
            if not self.room.fits_in_one_pass:
                some = self.backend.array(modes[:, :, piece * each : (piece + 1) * each])
                grid = xp.zeros((gx, gy, some.shape[2]), self._complex)
                grid[x[:, None], y[None, :]] = some
            own = grid is not modes or not kept
            grid = self.backend.fft.ifftn(grid, axes=lateral_axes(gx), overwrite_x=own, norm="forward")
            grid = xp.ascontiguousarray(grid).reshape(gx * gy, -1)
            part = xp.empty((len(self._scale), grid.shape[1]), self._complex)
            self.backend.launch(self._kernels.combine, part.shape[::-1], grid, self._from, part)
            spectra[:, cells[piece * each : (piece + 1) * each]] = part

        run_chunks("sensors", -(-f.count // each), work, watch)
        lines = self.backend.fft.ifft(spectra, axis=1, overwrite_x=True, norm="forward").real
        time = self.tables.time
        traces = xp.concatenate([lines[:, f.length - time.centre :], lines[:, : time.samples - time.centre]], axis=1)
        return traces * (self._window * (2 * self._scale)[:, None])

    def to_depth_adjoint(self, modes: Any, watch: ProgressMonitor = NO_MONITOR) -> Any:
        """Return the modes over time of modes over depth; only for transposable tables."""
        self._require_transposable()
        xp, f, each = self.backend.xp, self._found, self.room.orbits
        used_x, used_y = (len(axis.used) for axis in self._axes)
        if self.room.fits_in_one_pass:
            target = xp.zeros((*self.tables.lateral.grid, f.count), self._complex)
        else:
            target = np.empty((used_x, used_y, f.count), self._complex)

        def work(piece: int) -> None:
            source, result, orbits = modes, target, self._orbits
            where: Any = None
            if orbits is None:
                orbits, where, lines = orbit_slice(*self._axes, piece * each, (piece + 1) * each)
                source = self.backend.array(modes[lines])
                result, orbits = xp.empty((len(lines), used_y, f.count), self._complex), self._sent(orbits)
            count = len(orbits.squares_x) * len(orbits.squares_y)
            self.backend.launch(self._kernels.weigh, (source.shape[2], count), source, orbits, self._rule)
            self.backend.launch(self._kernels.to_time, (f.count, count), source, orbits, self._rule, result)
            if where is not None:
                target[where] = self.backend.host(result)

        run_chunks("depth to time", -(-(self.tables.lateral.modes[0] // 2 + 1) // each), work, watch)
        return target

    def to_image_adjoint(self, image: Any, watch: ProgressMonitor = NO_MONITOR) -> Any:
        """Return the modes over depth of an image; only for transposable tables, not upsampled."""
        self._require_transposable()
        if not self.room.fits_in_one_pass:
            return spectrum_in_chunks(self.tables, self.backend, self.room, image, watch)
        made = []

        def work(_: int) -> None:
            made.append(spectrum_of_image(self.tables, self.backend, self.array(image)))

        run_chunks("lateral transform", 1, work, watch)
        return made[0]

    def _spectra(self, traces: Any, scale: float, sensors: NDArray[Any] | None) -> Any:
        """Return the spectra (M, F) of A-lines; zero for sensors without A-lines."""
        xp, time, f = self.backend.xp, self.tables.time, self._found
        values = self.array(traces)
        which = None if sensors is None else self.backend.array(sensors)
        weights = self._scale if which is None else self._scale[which]
        fewer = self.tables.decimation
        if fewer is not None and values.shape[1] != fewer.samples:
            thin = xp.empty((len(values), fewer.samples), self._real)
            decimated = DecimationArgs(fewer.starts, fewer.taps.astype(self.tables.dtype))
            self.backend.launch(self._kernels.decimate, thin.shape[::-1], values, self._sent(decimated), thin)
            values = thin
        with np.errstate(over="ignore", invalid="ignore"):  # such traces are refused
            values = values * (weights * self._real(scale))[:, None]
            largest = float(xp.abs(values).max()) if values.size else 0.0
        if not largest < 2.0 ** MAX_EXPONENT[self.tables.dtype]:
            raise InvalidInput("traces", describe_non_finite(self.host(traces)), "finite numbers")
        values *= self._window
        line = xp.zeros((len(values), f.length), self._real)
        line[:, : time.samples - time.centre] = values[:, time.centre :]
        line[:, f.length - time.centre :] = values[:, : time.centre]
        found = xp.take(self.backend.fft.rfft(line, axis=1), self._places, axis=1)
        before, after = f.conjugated
        for some in (found[:, :before], found[:, f.count - after :]):
            xp.conjugate(some, out=some)
        if which is None:
            return found
        spectra = xp.zeros((len(self._scale), f.count), self._complex)
        spectra[which] = found
        return spectra

    def _sent(self, group: Any) -> Any:
        """Copy the arrays of a named tuple to the device."""
        return type(group)(*(self.backend.table(v) if isinstance(v, np.ndarray) else v for v in group))

    def with_sensors(self, lateral: LateralTransform) -> Self:
        """Return an engine with other sensors, on the same lateral grid, which shares the other tables."""
        other, host = copy(self), matrix(lateral)
        onto, scale = self._sent(sparse(host, self.tables.dtype)), self.array(lateral.scale)
        tables = replace(self.tables, lateral=lateral)
        vars(other).update(tables=tables, _host=host, _onto=onto, _from=None, _scale=scale)
        return other

    def _require_transposable(self) -> None:
        if not self.tables.transposable:
            raise NotImplementedError("these tables have no transpose")


def _dtypes(dtype: str) -> tuple[Any, Any]:
    return (np.float32, np.complex64) if dtype == "float32" else (np.float64, np.complex128)


if TYPE_CHECKING:

    def _is_an_engine(engine: CudaEngine) -> Engine:
        return engine
