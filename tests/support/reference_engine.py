"""Reference engine: the transforms in whole-array operations, readable and used to verify the fast engines.

It computes in the library of the arrays it is given, if that speaks the array API (2024.12), as NumPy, CuPy and JAX
do. Modes are complex arrays [x, y, n] here, without symmetry made use of. It reports no progress, nobody cancels it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from steradian.imaging.engines import NO_MONITOR, ProgressMonitor
from steradian.imaging.transform_tables import TransformTables
from steradian.imaging.transforms.lateral import Stencils, numbers_of
from steradian.imaging.transforms.time_to_depth import KappaMap

_BATCH = 64  # time samples spread, rows of modes interpolated at once


class ReferenceEngine:
    """Readable whole-array engine, used for comparison with the compiled ones.

    Parameters
    ----------
    tables
        What to compute.
    xp
        Namespace of the array API.
    dtype
        Precision to compute in; None: that of the tables.
    """

    def __init__(self, tables: TransformTables, *, xp: Any = np, dtype: str | None = None) -> None:
        self.tables, self._xp = tables, xp
        self._real = getattr(xp, dtype or tables.dtype)
        self._complex = xp.complex128 if self._real == xp.float64 else xp.complex64
        lateral = tables.lateral
        self._numbers = [numbers_of(n) for n in lateral.modes]
        factors = [lateral.factor(axis, j) for axis, j in enumerate(self._numbers)]
        if tables.rule.waves == "both":  # the model leaves out N/2, which is −N/2 as well
            for axis, n in enumerate(lateral.modes):
                factors[axis] = np.where((2 * self._numbers[axis] == -n) & (n > 1), 0, factors[axis])
        self._factor = self._array((factors[0][:, None] * factors[1])[:, :, None], complex=True)

    def lateral(
        self,
        traces: Any,
        watch: ProgressMonitor = NO_MONITOR,
        *,
        scale: float = 1.0,
        sensors: Any = None,
        onto: Any = None,
    ) -> Any:
        """Return the lateral modes over time of traces (NUFFT type 1)."""
        xp, lateral = self._xp, self.tables.lateral
        which = np.arange(len(lateral.scale)) if sensors is None else sensors
        values = xp.asarray(traces, dtype=self._real) * self._array(scale * lateral.scale[which])[:, None]
        x, y = (xp.asarray(j % n) for j, n in zip(self._numbers, lateral.grid, strict=True))
        parts = []
        for start in range(0, values.shape[1], _BATCH):
            part = values[:, start : min(start + _BATCH, values.shape[1])]
            grid = xp.zeros((lateral.grid[0] * lateral.grid[1], part.shape[1]), dtype=self._real)
            for cells, senders, weights in self._spread(which):
                grid = self._added(grid, cells, xp.take(part, senders, axis=0) * weights[:, None])
            grid = xp.asarray(xp.reshape(grid, (*lateral.grid, -1)), dtype=self._complex)
            spectrum = xp.fft.fftn(grid, axes=(0, 1))
            parts.append(xp.take(xp.take(spectrum, x, axis=0), y, axis=1) * self._factor)
        modes = xp.concat(parts, axis=2)
        return modes if onto is None else onto + modes

    def to_depth(self, modes: Any, watch: ProgressMonitor = NO_MONITOR, *, kept: bool = False) -> Any:
        """Return the modes over depth, by interpolation of the time spectrum at κ."""
        xp, g = self._xp, self.tables.geometry
        rising = xp.concat([self._interpolated(modes, i) for i in range(modes.shape[0])], axis=0)
        # those of −κ, as the traces are real: the conjugates at the opposite modes
        falling = xp.conj(xp.roll(xp.flip(rising, axis=(0, 1)), (1, 1), axis=(0, 1)))
        if self.tables.rule.waves == "both":
            rising = falling = rising + falling
        gap = xp.zeros((*rising.shape[:2], g.depth_points + 1 - 2 * rising.shape[2]), dtype=self._complex)
        (first, last), share = g.depth, g.depth_points / self.tables.spectrum_length
        rows = []
        for i in range(rising.shape[0]):  # row by row: less memory
            both = xp.concat([rising[i, ...], gap[i, ...], xp.flip(falling[i, :, 1:], axis=1)], axis=1)
            rows.append(xp.fft.ifft(both, axis=1)[None, :, first:last] * share)
        return xp.concat(rows, axis=0)

    def to_image(self, modes: Any, watch: ProgressMonitor = NO_MONITOR) -> Any:
        """Return the image of modes over depth, by inverse FFT."""
        xp, fine = self._xp, self.tables.image_modes
        more = 1.0
        for axis, n in enumerate(fine):
            more *= n / modes.shape[axis]
            modes = self._refined(modes, axis, n)
        (x, nx), (y, ny) = self.tables.visible_region
        image = xp.real(xp.fft.ifftn(modes, axes=(0, 1)))[x : x + nx, y : y + ny, :]
        return xp.reshape(image * more, self.tables.geometry.shape)

    def lateral_adjoint(self, modes: Any, watch: ProgressMonitor = NO_MONITOR, *, kept: bool = False) -> Any:
        """Return the traces of modes over time (NUFFT type 2)."""
        xp, lateral = self._xp, self.tables.lateral
        spectrum = modes * xp.conj(self._factor)
        for axis, n in enumerate(lateral.grid):
            spectrum = self._refined(spectrum, axis, n)
        grid = xp.real(xp.fft.ifftn(spectrum, axes=(0, 1))) * (lateral.grid[0] * lateral.grid[1])
        grid = xp.reshape(grid, (-1, modes.shape[2]))
        traces = xp.zeros((len(lateral.scale), modes.shape[2]), dtype=self._real)
        for cells, senders, weights in self._spread(np.arange(len(lateral.scale))):
            traces = self._added(traces, senders, xp.take(grid, cells, axis=0) * weights[:, None])
        return traces * self._array(lateral.scale)[:, None]

    def to_depth_adjoint(self, modes: Any, watch: ProgressMonitor = NO_MONITOR) -> Any:
        """Return the modes over time of modes over depth."""
        xp, time, (first, last) = self._xp, self.tables.time, self.tables.geometry.depth
        record = self.tables.geometry.depth_points
        left = xp.zeros((*modes.shape[1:2], first), dtype=self._complex)
        right = xp.zeros((*modes.shape[1:2], record - last), dtype=self._complex)
        rows = []
        for i in range(modes.shape[0]):
            spectrum = xp.fft.fft(xp.concat([left, modes[i, ...], right], axis=1), axis=1) / record
            cells, taps, factor = self._stencils(i)
            count = factor.shape[1]
            opposite = xp.flip(spectrum[:, record - count + 1 :], axis=1)
            both = spectrum[:, :count] + xp.concat([spectrum[:, :1] * 0, opposite], axis=1)
            line = xp.zeros(modes.shape[1] * time.length, dtype=self._complex)
            start = xp.arange(modes.shape[1])[:, None] * time.length
            for cell, tap in zip(cells, taps, strict=True):
                for place, value in ((cell, xp.conj(factor)), (-cell % time.length, factor)):
                    line = self._added(line, xp.reshape(start + place, (-1,)), xp.reshape(both * value * tap, (-1,)))
            line = xp.fft.ifft(xp.reshape(line, (-1, time.length)), axis=1) * time.length
            line = xp.roll(line, time.centre, axis=1)[:, : time.samples]
            rows.append((line * self._array(time.divided))[None, ...])
        return xp.concat(rows, axis=0)

    def to_image_adjoint(self, image: Any, watch: ProgressMonitor = NO_MONITOR) -> Any:
        """Return the modes over depth of an image, by FFT."""
        xp, ((x, nx), (y, ny)) = self._xp, self.tables.visible_region
        values = xp.reshape(xp.asarray(image, dtype=self._real), (nx, ny, -1))
        for axis, (first, n) in enumerate(((x, nx), (y, ny))):
            shape = list(values.shape)
            before, after = first, self.tables.image_modes[axis] - first - n
            ends = [xp.zeros([*shape[:axis], m, *shape[axis + 1 :]], dtype=self._real) for m in (before, after)]
            values = xp.concat([ends[0], values, ends[1]], axis=axis)
        spectrum = xp.fft.fftn(xp.asarray(values, dtype=self._complex), axes=(0, 1))
        return spectrum / (values.shape[0] * values.shape[1])

    def _array(self, values: Any, complex: bool = False) -> Any:
        return self._xp.asarray(np.asarray(values), dtype=self._complex if complex else self._real)

    def _spread(self, which: Any) -> Any:
        """Yield flat grid cells, sensor indices within ``which`` and weights, one stencil tap at a time."""
        xp, lateral = self._xp, self.tables.lateral
        s, (nx, ny) = lateral.sensors, lateral.grid
        if isinstance(s, Stencils):
            for t in range(s.tx.shape[1]):
                for u in range(s.ty.shape[1]):
                    cells = (s.first[which, 0] + t) % nx * ny + (s.first[which, 1] + u) % ny
                    weights = self._array(s.tx[which, t] * s.ty[which, u])
                    yield xp.asarray(cells), xp.arange(len(which)), weights
            return
        row = np.full(len(lateral.scale), -1)
        row[which] = np.arange(len(which))
        some = row[s.sensors] >= 0
        cells = (s.lines * ny + s.cells)[some]
        yield xp.asarray(cells), xp.asarray(row[s.sensors[some]]), self._array(s.weights[some])

    def _interpolated(self, modes: Any, i: int) -> Any:
        """Return the depth frequencies l ≥ 0 of the modes [i, y], interpolated at κ > 0."""
        xp, time = self._xp, self.tables.time
        line = modes[i, ...] * self._array(time.divided)
        gap = xp.zeros((line.shape[0], time.length - time.samples), dtype=self._complex)
        line = xp.fft.fft(xp.concat([line[:, time.centre :], gap, line[:, : time.centre]], axis=1), axis=1)
        cells, taps, factor = self._stencils(i)
        found = xp.zeros(factor.shape, dtype=self._complex)
        for cell, tap in zip(cells, taps, strict=True):
            found = found + xp.take_along_axis(line, cell, axis=1) * tap
        return (found * factor)[None, ...]

    def _stencils(self, i: int) -> tuple[list[Any], list[Any], Any]:
        """Return grid cells, tap weights and phase factors of the modes [i, y] at each l ≥ 0 (float64)."""
        time, rule = self.tables.time, self.tables.rule
        l = np.arange((self.tables.geometry.depth_points + 1) // 2)  # noqa: E741
        across = np.hypot(rule.scales[0] * self._numbers[0][i], rule.scales[1] * self._numbers[1])[:, None]
        kappa = np.sqrt(l**2 + across**2)
        width = time.taps.shape[0]
        u = kappa * time.length / time.record
        left = u - width / 2
        first = np.floor(u + 0.5) if time.nearest else np.floor(left) + 1
        y = 2 * (left - np.floor(left)) - 1
        taps = [np.polynomial.polynomial.polyval(y, p) for p in time.taps]
        with np.errstate(invalid="ignore", divide="ignore"):
            gain = np.where(kappa > 0, 2 * l / kappa, 2.0) if rule.waves == "rising" else np.full(kappa.shape, 0.5)
            sine = np.where(kappa > 0, across / kappa, 0.0)
        factor = (
            gain * np.exp(-2j * np.pi * rule.turns * kappa) * _interpolate_response(rule.table, rule.steps, kappa, sine)
        )
        factor = factor * _layer_factor(rule, kappa, across, l)
        cells = [self._xp.asarray((first.astype(np.int64) + t) % time.length) for t in range(width)]
        return cells, [self._array(tap) for tap in taps], self._array(factor * (kappa < rule.band), complex=True)

    def _added(self, target: Any, index: Any, values: Any) -> Any:
        """Add rows to a target at indices that may repeat, which the array API standard cannot express."""
        if hasattr(target, "at"):  # JAX, whose arrays do not change
            return target.at[index].add(values)
        self._xp.add.at(target, index, values)
        return target

    def _refined(self, modes: Any, axis: int, count: int) -> Any:
        """Zero-pad modes to ``count`` ≥ N points; the mode at −N/2 is split evenly with +N/2."""
        xp, n = self._xp, modes.shape[axis]
        if count == n:
            return modes
        modes = xp.moveaxis(modes, axis, 0)
        low, high = modes[: (n + 1) // 2, ...], modes[(n + 1) // 2 :, ...]
        gap = xp.zeros((count - n, *modes.shape[1:]), dtype=self._complex)
        if n % 2 == 0:
            half = high[:1, ...] / 2
            high, low, gap = xp.concat([half, high[1:, ...]], axis=0), xp.concat([low, half], axis=0), gap[1:, ...]
        return xp.moveaxis(xp.concat([low, gap, high], axis=0), 0, axis)


def _layer_factor(rule: KappaMap, kappa: Any, across: Any, l: Any) -> Any:  # noqa: E741
    """Return the factor of the layers above (:class:`KappaMap`)."""
    if not len(rule.overlying):
        return 1.0
    turns, passed = -rule.shift * l, True
    for a, b in rule.overlying:
        root = a * kappa**2 - b * across**2
        turns, passed = turns + np.sqrt(np.maximum(root, 0)), passed & (root > 0)
    return passed * np.exp(2j * np.pi * turns)


def _interpolate_response(table: Any, steps: Any, kappa: Any, sine: Any) -> Any:
    """Interpolate the response bilinearly at κ and the sine: amplitude and phase in turns of 2π."""
    if table.shape[1] == 1:
        return 1.0
    u = np.minimum(kappa * steps[0], table.shape[1] - 1.000001)
    v = np.minimum(sine * steps[1], table.shape[2] - 1.000001)
    i, k = u.astype(int), v.astype(int)
    a, b = u - i, v - k
    low = table[:, i, k] * (1 - b) + table[:, i, k + 1] * b
    high = table[:, i + 1, k] * (1 - b) + table[:, i + 1, k + 1] * b
    amplitude, turns = low * (1 - a) + high * a
    return amplitude * np.exp(2j * np.pi * turns)
