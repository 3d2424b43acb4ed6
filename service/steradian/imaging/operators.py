"""Forward model and its adjoint: from a volume of initial pressure to the A-lines, and the transposed way.

The model, for a volume f[x, y, z] on the image's points (axes [x, z] in 2-D), period X and N modes a lateral axis
with the lateral padding, L depth frequencies, and κ(j, l) = √(l² + Σ(L·Δz/X)²j²) as in the paper's equation 4:

    p(x_m, t_n) = 1/(ΠN·L) Σ_j e^{2πi j·x_m/X} Σ_{|l| < L/2} f̂(j, l) · |S| cos(2πκ(t_n/dt)/L + arg S)

with the discrete Fourier transform f̂ of the volume, zero around it. It is the exact solution of the wave equation
for the band-limited function through the voxels' values, periodic over X and, together with its mirror image at the
film, over L·Δz. L is chosen such that no copy along the depth is heard within the record; the lateral padding does
the same sideways (:func:`quiet_padding`). Lateral modes at the Nyquist frequency of an even N, and all κ beyond the
Nyquist frequency of time or beyond ``highest_frequency``, are left out. S is the film's response (:mod:`.response`),
or 1.

The paper's formula (equation 7) is the pseudo-inverse of this for sensors everywhere, up to the waves that leave
downwards along the film.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import factorial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray
from scipy.sparse.linalg import LinearOperator

from steradian.errors import InvalidInput
from steradian.imaging import checks, memory, workers
from steradian.imaging.checks import Sensors
from steradian.imaging.factors import fast_size
from steradian.imaging.geometry import Geometry
from steradian.imaging.lateral import Lateral, grid_of, gridded, non_uniform
from steradian.imaging.plan import ReconstructionPlan
from steradian.imaging.response import FilmResponse, tabulated
from steradian.imaging.sizes import lateral_grid
from steradian.imaging.volume import RealArray
from steradian.imaging.windows import Shape, Window
from steradian.progress import IsCancelled, Progress
from steradian.ranges import SAMPLING_INTERVAL, SOUND_SPEED, real

if TYPE_CHECKING:
    _Base = LinearOperator[Any]
else:
    _Base = LinearOperator

_PAD = 24  # propagation.PAD, which needs Numba to import
_BATCH = 32  # samples of a cell
MOST_PADDING = 16.0
_BLOCKS = 32  # most blocks of columns a piece of work has


class _ModelPlan(ReconstructionPlan):
    """A plan whose modes are all stored and read once: no coarser grid that repeats, no Nyquist copies."""

    def _prepare_lateral(self, places: NDArray[np.float64], method: Any, window: Shape | Window) -> None:
        self.method = "nedner"
        self._share = 0.4 * self.tolerance / np.sqrt(len(self.geometry.modes) + 1)
        grid = grid_of(places, self._modes, 0.1 * self.tolerance)
        step = [round(np.rint(n / g[0])) for n, g in zip(self._modes, grid or [], strict=False)]
        ones = np.ones(len(places))
        if grid is not None and all(
            g[0] * s == n and g[1] == 0 for g, s, n in zip(grid, step, self._modes, strict=True)
        ):
            lateral: Lateral = gridded(places, ones, self._modes, [(n, 0.0) for n in self._modes], self.dtype)
        else:
            sizes, found = lateral_grid(self._modes, len(places), window, self._share)
            windows = (None if self._modes[0] == 1 else found, found)
            lateral = non_uniform(places, ones, self._modes, windows, sizes, self.dtype)
        self._lateral = replace(lateral, edge_rows=np.full_like(lateral.edge_rows, -1))


class ForwardOperator(_Base):
    """A-lines of a volume as a linear operator, shape (M·N_t, voxels).

    ``operator @ volume.ravel()`` and ``operator.T @ traces.ravel()`` as for any
    :class:`scipy.sparse.linalg.LinearOperator`; :meth:`forward` and :meth:`backward` take and give arrays. The two are
    transposes of each other to rounding error; ``tolerance`` is the model's relative error against its direct sums.

    Parameters
    ----------
    positions, samples, sampling_interval, sound_speed, aperture, modes, depth_range, time_zero
        As in :func:`steradian.imaging.reconstruct`; volumes have the shape of its image.
    lateral_padding
        Factor by which the aperture is extended sideways. None: as much as keeps the periodic copies of the volume out
        of the record (:func:`quiet_padding`), about (aperture + c·duration)/aperture; transforms and memory grow by it
        along each axis. With less, copies are heard: 1 is exact for a medium that repeats.
    response
        The film's response inside the model; None: an ideal sensor.
    highest_frequency
        Hz beyond which the model is silent; None: the Nyquist frequency of time.
    tolerance, window, wrap, dtype, memory_limit, threads
        As in :func:`steradian.imaging.reconstruct`.

    Attributes
    ----------
    geometry
        The checked geometry, with ``shape``, ``spacing`` and ``axes()`` of the volume.
    memory_bytes
        Bound of what one product allocates, its result included.

    Raises
    ------
    InvalidInput
        If a parameter is out of range.
    """

    def __init__(
        self,
        positions: ArrayLike | Sensors,
        *,
        samples: int,
        sampling_interval: float,
        sound_speed: float,
        aperture: float | Sequence[float] | None = None,
        modes: int | Sequence[int],
        depth_range: tuple[float, float] | None = None,
        time_zero: float = 0.0,
        lateral_padding: float | None = None,
        response: FilmResponse | None = None,
        highest_frequency: float | None = None,
        tolerance: float = 1e-4,
        window: Shape | Window = "kaiser-bessel",
        wrap: bool = False,
        dtype: DTypeLike | None = None,
        memory_limit: int | None = None,
        threads: int | None = None,
    ) -> None:
        positions, _, aperture = checks.of_mask(positions, None, aperture)
        positions = checks.places(positions)
        aperture = checks.apertures(aperture, positions.shape[1])
        samples = checks.whole("samples", samples, 4, checks.MOST_SAMPLES)
        sampling_interval = SAMPLING_INTERVAL.check("sampling_interval", sampling_interval)
        sound_speed = SOUND_SPEED.check("sound_speed", sound_speed)
        time_zero = real("time_zero", time_zero, "a finite time in s")
        common: dict[str, Any] = {
            "sampling_interval": sampling_interval,
            "sound_speed": sound_speed,
            "aperture": aperture,
            "modes": modes,
            "lateral_padding": lateral_padding,
            "tolerance": tolerance,
            "window": window,
            "dtype": dtype,
            "memory_limit": memory_limit,
            "threads": threads,
        }
        step = sampling_interval * sound_speed
        whole = (0.0, (samples - 1) * step)
        depth_range = whole if depth_range is None else checks.depths(depth_range, whole[1])
        if lateral_padding is None:
            common["lateral_padding"] = quiet_padding(
                positions,
                aperture=aperture,
                duration=samples * sampling_interval + max(0.0, time_zero),
                sound_speed=sound_speed,
                depth=depth_range[0],
            )
        deepest = int(np.floor(depth_range[1] / step + 1e-6)) + 1
        heard = samples + max(0, int(np.ceil(time_zero / sampling_interval)))
        # the mirror image's next copy lies at L − z; its sound comes no earlier than sample L − z
        record = fast_size(deepest + heard)
        plan = _ModelPlan(
            positions,
            weights=_any_weights(len(positions), aperture),
            samples=samples,
            depth_range=depth_range,
            time_zero=time_zero,
            time_padding=max(1.0, record / samples),
            wrap=wrap,
            **common,
        )
        self._plan, g = plan, plan.geometry
        self._stride = plan._source_stride
        columns = _points(g)
        self._voxels = _ModelPlan(columns, weights=_any_weights(len(columns), aperture), samples=g.shape[-1], **common)
        self._voxels._source_stride = self._stride
        self._factors, self._band = self._columns(highest_frequency)
        self._response = response
        self._table, self._steps = tabulated(
            response, nyquist=0.5 / sampling_interval, bandwidth=0.5 * g.record, sound_speed=sound_speed
        )
        self.memory_bytes = max(plan.memory_bytes, self._bytes(plan), self._bytes(self._voxels))
        memory.require(self.memory_bytes, memory_limit, g.shape)
        self.volume_shape, self.trace_shape = g.shape, (len(g.positions), g.samples)
        super().__init__(  # type: ignore[call-arg]
            np.dtype(plan.dtype), (int(np.prod(self.trace_shape)), int(np.prod(g.shape)))
        )

    @property
    def geometry(self) -> Geometry:
        """The checked geometry."""
        return self._plan.geometry

    @property
    def threads(self) -> int:
        """Threads a product uses."""
        return self._plan.threads

    def _columns(self, highest: float | None) -> tuple[RealArray, float]:
        """Real factors of each block's lanes (Nyquist modes 0), and the bound of κ."""
        g, table = self._plan.geometry, self._plan._blocks
        nx, ny = self._plan._modes
        column = np.maximum(table.target, 0) // 2
        i, k = column // (ny // 2 + 1), column % (ny // 2 + 1)
        silent = ((2 * i == nx) & (nx > 1)) | (2 * k == ny)
        factors = table.factors.copy()
        factors[:, :16][silent] = 0
        band = 0.5 * g.record
        if highest is not None:
            if not (np.isfinite(highest) and highest > 0):
                raise InvalidInput("highest_frequency", highest, "a frequency above 0 Hz, or None")
            band = min(band, highest * g.sampling_interval * g.record)
        return factors, band

    def _bytes(self, plan: ReconstructionPlan) -> int:
        nx, ny = plan._lateral.grid
        item = np.dtype(plan.dtype).itemsize
        modes = (self._plan._source_rows + 1) * self._stride * item
        line = max(nx, ny + 24)
        scratch = 32 * item * (len(plan._lateral.spread.order) + 5 * line + 2 * len(plan._lateral.ys) * nx)
        g = self._plan.geometry
        result = max(int(np.prod(g.shape)), len(g.positions) * g.samples)
        return modes + plan.threads * scratch + item * result

    def forward(
        self, volume: ArrayLike, *, progress: Progress | None = None, cancelled: IsCancelled | None = None
    ) -> RealArray:
        """A-lines, shape (M, N_t), of initial pressure [x, y, z] ([x, z] in 2-D).

        Raises
        ------
        InvalidInput
            If the shape does not fit or a value is not finite.
        Cancelled
            If ``cancelled`` said so.
        """
        from steradian.imaging.execute import _lateral
        from steradian.imaging.propagation import to_time

        values = self._checked("volume", volume, self.volume_shape)
        how = self._how(progress, cancelled)
        modes = self._modes()
        _lateral(self._voxels, values.reshape(-1, self.volume_shape[-1]), 1.0, modes, how)
        self._propagate("depth to time", to_time, modes, how)
        traces = np.empty(self.trace_shape, self._plan.dtype)
        self._sense(modes, traces.reshape(-1), how)
        return traces

    def backward(
        self, traces: ArrayLike, *, progress: Progress | None = None, cancelled: IsCancelled | None = None
    ) -> RealArray:
        """Volume that the transposed operator makes of traces of shape (M, N_t); errors as for :meth:`forward`."""
        from steradian.imaging.execute import _images, _lateral
        from steradian.imaging.propagation import to_depth

        values = self._checked("traces", traces, self.trace_shape)
        how = self._how(progress, cancelled)
        modes = self._modes()
        _lateral(self._plan, values, 1.0, modes, how)
        self._propagate("time to depth", to_depth, modes, how)
        size = int(np.prod(self.volume_shape))
        image = modes if self._plan._shared else np.empty(size, self._plan.dtype)
        _images(self._plan, modes, image, how)
        return image[:size].reshape(self.volume_shape)

    def _matvec(self, x: NDArray[Any]) -> NDArray[Any]:
        return self.forward(np.asarray(x).reshape(self.volume_shape)).ravel()

    def _rmatvec(self, x: NDArray[Any]) -> NDArray[Any]:
        return self.backward(np.asarray(x).reshape(self.trace_shape)).ravel()

    def _checked(self, name: str, values: ArrayLike, shape: tuple[int, ...]) -> RealArray:
        array = np.ascontiguousarray(values, self._plan.dtype)
        if array.shape != shape:
            raise InvalidInput(name, f"an array of shape {array.shape}", f"shape {shape}")
        return array

    def _how(self, progress: Progress | None, cancelled: IsCancelled | None) -> dict[str, Any]:
        return {"threads": self._plan.threads, "progress": progress, "cancelled": cancelled}

    def _modes(self) -> RealArray:
        modes = np.empty((self._plan._source_rows + 1) * self._stride, self._plan.dtype)
        modes[self._plan._source_rows * self._stride :] = 0  # the spare row, of lanes not in use
        return modes

    def _propagate(self, stage: str, kernel: Callable[..., None], modes: RealArray, how: dict[str, Any]) -> None:
        """Run the columns in place, from depth to time or back."""
        plan, g, table = self._plan, self._plan.geometry, self._plan._blocks
        *_, ft, fz, _, _ = plan.transforms()
        times, depths = _tables(ft), _tables(fz)
        spare = plan._source_rows
        real = np.where(table.target < 0, spare, table.target) * self._stride
        imaginary = np.where(table.target < 0, spare, table.target + 1) * self._stride
        terms = 6 if plan.dtype == "float32" else 11
        sine = np.array([(-1) ** i / factorial(2 * i + 1) for i in range(terms)], plan.dtype)
        cosine = np.array([(-1) ** i / factorial(2 * i) for i in range(terms)], plan.dtype)
        ones, unit = np.ones(g.shape[-1], plan.dtype), np.ones(16, plan.dtype)
        each = min(_BLOCKS, -(-len(real) // 16))

        def scratch() -> tuple[NDArray[Any], ...]:
            cells = max(plan._length, g.record) + 2 * _PAD
            pitch = -(-(g.record // 2 + 2) // 16) * 16
            return (
                np.zeros(cells * 32, plan.dtype),
                np.zeros(cells * 32, plan.dtype),
                np.zeros(pitch, np.int32),
                *(np.zeros(pitch, plan.dtype) for _ in range(3)),
                np.zeros(pitch * len(plan._taps), plan.dtype),
                np.zeros(max(ft.scratch, fz.scratch, 16) * 32, plan.dtype),
            )

        def work(piece: int, space: tuple[NDArray[Any], ...], flag: NDArray[np.uint8]) -> None:
            kernel(
                piece * each, min((piece + 1) * each, len(real)), modes, real, imaginary, self._factors, table.squares,
                modes, real, imaginary, g.samples, plan._centre, plan._length, plan._time_window,
                g.record, self._band, plan._length / g.record, plan._turns, self._table, self._steps, plan._taps,
                sine, cosine, g.depth[0], g.depth[1] - g.depth[0], ones, unit, times, depths, flag, *space,
            )  # fmt: skip

        workers.run(stage, -(-len(real) // each), scratch, work, **how)

    def _sense(self, modes: RealArray, traces: RealArray, how: dict[str, Any]) -> None:
        """Lateral modes over time to the sensors' traces."""
        from steradian.imaging.sensing import sense

        plan, lateral, spread = self._plan, self._plan._lateral, self._plan._lateral.spread
        tables = [_tables(t) for t in self._sensor_transforms()]
        nx, ny = lateral.grid
        line = max(nx, ny + spread.wy.shape[1])
        tmp = max(*(t.scratch for t in self._sensor_transforms()), 1)
        samples = plan.geometry.samples

        def scratch() -> tuple[NDArray[Any], ...]:
            cells = (len(spread.order), line, line, line, line, 2 * len(lateral.ys) * nx, tmp)
            return tuple(np.empty(c * 32, plan.dtype) for c in cells)

        def work(piece: int, space: tuple[NDArray[Any], ...], flag: NDArray[np.uint8]) -> None:
            start = piece * _BATCH
            sense(
                modes, self._stride, start, min(_BATCH, samples - start), *plan._modes,
                spread.separable, spread.starts, spread.first, spread.sensors, spread.wx, spread.wy, nx, ny,
                spread.order, spread.scale, tables[0], tables[1], flag, *space, traces, samples,
            )  # fmt: skip

        workers.run("sensors", -(-samples // _BATCH), scratch, work, **how)

    def _sensor_transforms(self) -> tuple[Any, Any]:
        return self._plan.transforms()[0], self._plan.transforms()[1]


def _any_weights(count: int, aperture: tuple[float, ...]) -> NDArray[np.float64]:
    """Weights of a plan that needs some: they are no part of the model."""
    return np.full(count, float(np.prod(aperture)) / count)


def _tables(t: Any) -> tuple[Any, ...]:
    return t.radices, t.twiddles, t.twiddle_starts, t.generic, t.generic_starts


def _points(g: Geometry) -> NDArray[np.float64]:
    """Lateral coordinates of the volume's columns in the order of its memory, shape (columns, d−1)."""
    axes = g.axes()
    if axes.y is None:
        return np.asarray(axes.x[:, None])
    x, y = np.meshgrid(axes.x, axes.y, indexing="ij")
    return np.stack([x.ravel(), y.ravel()], axis=1)


def quiet_padding(
    positions: ArrayLike, *, aperture: float | Sequence[float], duration: float, sound_speed: float, depth: float = 0.0
) -> float:
    """Lateral padding with which no sensor hears a periodic copy of the volume within the record.

    Parameters
    ----------
    positions
        Sensors in metres, shape (M, d−1) or (M,).
    aperture
        Side lengths of the volume in metres.
    duration
        Time of the last sample, in s.
    sound_speed
        In m/s.
    depth
        Where the volume begins, in m.

    Raises
    ------
    InvalidInput
        If more is needed than a transform takes.
    """
    x = np.asarray(positions, np.float64)
    x = x[:, None] if x.ndim == 1 else x
    sides = np.broadcast_to(np.asarray(aperture, np.float64), (x.shape[1],))
    heard = np.sqrt(max(0.0, (sound_speed * duration) ** 2 - depth**2))
    needed = (np.abs(x).max(axis=0) + sides / 2 + heard) / sides
    padding = float(max(1.0, needed.max()))
    if padding > MOST_PADDING:
        allowed = f"at most {MOST_PADDING:g}: a shorter record, a wider aperture or modes, or a padding of your own"
        raise InvalidInput("lateral_padding", f"{padding:.3g}, needed against periodic copies", allowed)
    return padding
