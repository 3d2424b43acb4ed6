"""Forward model and its adjoint: from a volume of initial pressure to the A-lines, and the transposed way.

The model, for a volume f[x, y, z] on the image's points (axes [x, z] in 2-D), period X and N modes a lateral axis
with the lateral padding, L depth frequencies, and κ(j, l) = √(l² + Σ(L·Δz/X)²j²) as in the paper's equation 4:

    p(x_m, t_n) = 1/(ΠN·L) Σ_j e^{2πi j·x_m/X} Σ_{|l| < L/2} f̂(j, l) · |S| cos(2πκ(t_n/dt)/L + arg S)

with the discrete Fourier transform f̂ of the volume, zero around it. It is the exact solution of the wave equation
for the band-limited function through the voxels' values, periodic over X and, together with its mirror image at the
film, over L·Δz. L is chosen such that no copy along the depth is heard within the record; the lateral padding does
the same sideways (:func:`artefact_free_padding`). Lateral modes at the Nyquist frequency of an even N, and all κ beyond
the Nyquist frequency of time or beyond ``highest_frequency``, are left out. S is the film's response
(:mod:`.response`), or 1.

The paper's formula (equation 7) is the pseudo-inverse of this for sensors everywhere, up to the waves that leave
downwards along the film.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray
from scipy.sparse.linalg import LinearOperator

from steradian.core.exceptions import InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.imaging import validation as checks
from steradian.imaging.compute import memory_limit as memory
from steradian.imaging.engines import ProgressMonitor, run_forward, run_inverse
from steradian.imaging.engines.array_namespace import is_gpu_array, to_numpy
from steradian.imaging.engines.numba.engine import NumbaEngine
from steradian.imaging.engines.numba.memory_plan import min_bytes
from steradian.imaging.engines.selection import AnyEngine, EngineSelector
from steradian.imaging.film_response import FilmResponse, InverseFilter
from steradian.imaging.geometry.depth_extent import Extent
from steradian.imaging.geometry.reconstruction import ReconstructionGeometry, geometry
from steradian.imaging.parameters import Device, Parameters
from steradian.imaging.tables import TransformTables, forward_tables
from steradian.imaging.transforms.grid_sizes import fast_size
from steradian.imaging.transforms.windows import Shape, Window
from steradian.imaging.validation import Sensors
from steradian.imaging.volume import RealArray

if TYPE_CHECKING:
    _LinearOperator = LinearOperator[Any]
else:
    _LinearOperator = LinearOperator

MAX_PADDING = 16.0


class ForwardOperator(_LinearOperator):
    """A-lines of a volume as a linear operator, shape (M·N_t, voxels).

    ``operator @ volume.ravel()`` and ``operator.T @ traces.ravel()`` as for any
    :class:`scipy.sparse.linalg.LinearOperator`; :meth:`forward` and :meth:`backward` take and give arrays, CuPy's where
    they are given some of a GPU. The two are transposes of each other to rounding error; ``tolerance`` is the model's
    relative error against its direct sums.

    Parameters
    ----------
    positions, samples, sampling_interval, sound_speed, aperture, modes, depth_range, time_zero
        As in :func:`steradian.imaging._reconstruct`; volumes have the shape of its image.
    lateral_padding
        Factor by which the aperture is extended sideways. None: as much as keeps the periodic copies of the volume out
        of the record (:func:`artefact_free_padding`), about (aperture + c·duration)/aperture; transforms and memory
        grow by it along each axis. With less, copies are heard: 1 is exact for a medium that repeats.
    response
        The film's response inside the model; None: an ideal sensor.
    highest_frequency
        Hz beyond which the model is silent; None: the Nyquist frequency of time.
    tolerance, window, wrap, dtype, memory_limit, threads, device, device_memory
        As in :func:`steradian.imaging._reconstruct`.

    Attributes
    ----------
    tables, chosen, engine
        What is computed, which engine was chosen for it, and that (:mod:`steradian.imaging.engines`).
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
        device: Device = "cpu",
        device_memory: int | None = None,
    ) -> None:
        chosen = Parameters(
            sampling_interval=sampling_interval, sound_speed=sound_speed, aperture=aperture, modes=modes,
            depth_range=depth_range, tolerance=tolerance, window=window, time_zero=time_zero,
            lateral_padding=lateral_padding, wrap=wrap, highest_frequency=highest_frequency,
            correction=None if response is None else InverseFilter(response), dtype=dtype, memory_limit=memory_limit,
            threads=threads, device=device, device_memory=device_memory,
        )  # fmt: skip
        self.tables, self.chosen = _made(positions, samples, chosen)
        super().__init__(*_size(self.tables))  # type: ignore[call-arg]

    @classmethod
    def of(cls, positions: ArrayLike | Sensors, samples: int, parameters: Parameters) -> Self:
        """Make an operator of parameters that are one value already, with the response that they correct for."""
        operator = object.__new__(cls)
        operator.tables, operator.chosen = _made(positions, samples, parameters)
        _LinearOperator.__init__(operator, *_size(operator.tables))  # type: ignore[call-arg]
        return operator

    @property
    def engine(self) -> AnyEngine:
        """Name of the engine in use."""
        return self.chosen.engine

    @property
    def volume_shape(self) -> tuple[int, ...]:
        """Of volumes, [x, y, z] ([x, z] in 2-D)."""
        return self.geometry.shape

    @property
    def trace_shape(self) -> tuple[int, int]:
        """Of A-lines, (M, N_t)."""
        return len(self.geometry.positions), self.geometry.samples

    @property
    def geometry(self) -> ReconstructionGeometry:
        """The checked geometry."""
        return self.tables.geometry

    @property
    def threads(self) -> int:
        """Threads a product uses."""
        return self.engine.room.threads

    @property
    def memory_bytes(self) -> int:
        """Upper bound of the memory that one product allocates, its result included."""
        return self.engine.room.memory_bytes

    def forward(
        self, volume: ArrayLike, *, progress: Progress | None = None, cancelled: CancelCheck | None = None
    ) -> RealArray:
        """A-lines, shape (M, N_t), of initial pressure [x, y, z] ([x, z] in 2-D).

        Raises
        ------
        InvalidInput
            If the shape does not fit or a value is not finite.
        Cancelled
            If ``cancelled`` said so.
        """
        return self._product(run_forward, "volume", volume, self.volume_shape, ProgressMonitor(progress, cancelled))

    def backward(
        self, traces: ArrayLike, *, progress: Progress | None = None, cancelled: CancelCheck | None = None
    ) -> RealArray:
        """Apply the adjoint to traces of shape (M, N_t) and return a volume; errors as for :meth:`forward`."""
        return self._product(run_inverse, "traces", traces, self.trace_shape, ProgressMonitor(progress, cancelled))

    def _matvec(self, x: NDArray[Any]) -> NDArray[Any]:
        return self.forward(np.asarray(x).reshape(self.volume_shape)).ravel()

    def _rmatvec(self, x: NDArray[Any]) -> NDArray[Any]:
        return self.backward(np.asarray(x).reshape(self.trace_shape)).ravel()

    def _product(
        self, make: Callable[..., Any], name: str, values: Any, shape: tuple[int, ...], watch: ProgressMonitor
    ) -> RealArray:
        array = self.chosen.as_engine_array(name, values)
        if array.shape != shape:
            raise InvalidInput(name, f"an array of shape {array.shape}", f"shape {shape}")

        def work(engine: AnyEngine) -> Any:
            if isinstance(engine, NumbaEngine):
                return make(engine, np.ascontiguousarray(to_numpy(array), self.tables.dtype), watch)
            return make(engine, array, watch)

        found: RealArray = self.chosen.run_with_fallback(work, keep=is_gpu_array(values))
        return found


def _size(tables: TransformTables) -> tuple[np.dtype[Any], tuple[int, int]]:
    g = tables.geometry
    return np.dtype(tables.dtype), (len(g.positions) * g.samples, int(np.prod(g.shape)))


def _made(positions: ArrayLike | Sensors, samples: int, chosen: Parameters) -> tuple[TransformTables, EngineSelector]:
    positions, _, aperture = checks.resolve_sensors(positions, None, chosen.aperture)
    positions = checks.check_positions(positions)
    aperture = checks.apertures(aperture, positions.shape[1])
    samples = checks.check_integer("samples", samples, 4, checks.MAX_SAMPLES)
    found = geometry(positions, samples, _for_model(chosen, positions, aperture, samples))
    memory.check_memory(min_bytes(found, chosen.precision), chosen.memory_limit, found.shape)
    tables = forward_tables(found, chosen)
    return tables, EngineSelector(tables, chosen)


def _for_model(
    chosen: Parameters, positions: NDArray[np.float64], aperture: tuple[float, ...], samples: int
) -> Parameters:
    """Add the paddings that keep copies of the volume out of the record."""
    step = chosen.sampling_interval * chosen.sound_speed
    extent = Extent.of(samples, chosen.sampling_interval, chosen.time_zero)
    whole = (extent.first * step, (extent.end - 1) * step)
    depth_range = whole if chosen.depth_range is None else checks.depths(chosen.depth_range, extent.end * step)
    lateral = chosen.lateral_padding
    if lateral is None:
        duration = samples * chosen.sampling_interval + max(0.0, chosen.time_zero)
        lateral = artefact_free_padding(
            positions, aperture=aperture, duration=duration, sound_speed=chosen.sound_speed, depth=depth_range[0]
        )
    deepest = int(np.floor(depth_range[1] / step + 1e-6)) + 1
    # the mirror image's next copy lies at L − z; its sound comes no earlier than sample L − z
    record = fast_size(deepest + samples + extent.ahead)
    padding = (record - extent.ahead) / samples
    if padding > MAX_PADDING:
        latest = (MAX_PADDING - 2) * samples * chosen.sampling_interval
        allowed = f"at most about {latest:.3g} (s), {MAX_PADDING - 2:g} times the record's length, for a model"
        raise InvalidInput("time_zero", chosen.time_zero, allowed)
    return replace(
        chosen,
        aperture=aperture,
        weights=np.full(len(positions), float(np.prod(aperture)) / len(positions)),  # no part of the model
        depth_range=depth_range,
        time_padding=padding,
        lateral_padding=lateral,
        highest_frequency=None,  # slices are as far apart as samples
    )


def artefact_free_padding(
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
    if padding > MAX_PADDING:
        allowed = f"at most {MAX_PADDING:g}: a shorter record, a wider aperture or modes, or a padding of your own"
        raise InvalidInput("lateral_padding", f"{padding:.3g}, needed against periodic copies", allowed)
    return padding
