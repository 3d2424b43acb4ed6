"""Forward operator and its adjoint: from a volume of initial pressure to A-lines, and back.

The model, for a volume f[x, y, z] on the image's points (axes [x, z] in 2-D), period X and N modes a lateral axis
with the lateral padding, L depth frequencies, and κ(j, l) = √(l² + Σ(L·Δz/X)²j²) as in the paper's equation 4:

    p(x_m, t_n) = 1/(ΠN·L) Σ_j e^{2πi j·x_m/X} Σ_{|l| < L/2} f̂(j, l) · |S| cos(2πκ(t_n/dt)/L + arg S)

with the discrete Fourier transform f̂ of the volume, zero around it. It is the exact solution of the wave equation
for the band-limited function through the voxels' values, periodic over X and, together with its mirror image at the
film, over L·Δz. L is chosen such that no copy along the depth is heard within the record; the lateral padding does
the same sideways (:func:`.geometry.model.artefact_free_padding`). Lateral modes at the Nyquist frequency of an even N,
and all κ beyond the Nyquist frequency of time or beyond ``max_frequency``, are left out. S is the film's response
(:mod:`.film_response`), or 1.

In a medium of several layers each layer has such a model below the plane of its first slice, and the field that this
plane hears from the pulse on is extrapolated to the film (:mod:`.transforms.extrapolation`). Echoes between boundaries,
and what the boundaries reflect downwards, are left out. Attenuation is a matrix over time that the A-lines are
multiplied with at the end (:mod:`.signal.attenuation`): N_t² numbers, and M·N_t² multiplications a product. In layers
it acts on the field at the layer's plane, for each mode, and the layers above attenuate what crosses them.

The paper's formula (equation 7) is the pseudo-inverse of this for sensors everywhere, up to the waves that leave
downwards along the film.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.linalg import LinearOperator

from steradian.core.exceptions import InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.core.quantity_ranges import TOLERANCE
from steradian.imaging.acquisition import AcquisitionGeometry
from steradian.imaging.compute import memory_limit as memory
from steradian.imaging.engines import ProgressMonitor, run_forward, run_inverse
from steradian.imaging.engines.array_namespace import is_gpu_array, like, to_numpy
from steradian.imaging.engines.numba.engine import NumbaEngine
from steradian.imaging.engines.numba.layered import LayeredEngine
from steradian.imaging.engines.numba.memory_plan import min_bytes
from steradian.imaging.engines.selection import AnyEngine, EngineSelector
from steradian.imaging.film_response import FilmResponse
from steradian.imaging.geometry.model import LayerGeometry, layered_geometries, model_geometry
from steradian.imaging.geometry.reconstruction import ReconstructionGeometry
from steradian.imaging.geometry.sensor_sensitivity import check_sensitivity
from steradian.imaging.layered_tables import layered_tables
from steradian.imaging.options import Compute, ImageGrid, check_max_frequency, check_window
from steradian.imaging.signal.attenuation import attenuation_matrix
from steradian.imaging.transform_tables import forward_tables
from steradian.imaging.transforms.windows import Shape, Window
from steradian.imaging.volume import RealArray

if TYPE_CHECKING:
    _LinearOperator = LinearOperator[Any]
else:
    _LinearOperator = LinearOperator


class ForwardOperator(_LinearOperator):
    """Linear forward operator from a volume to A-lines, shape (M·N_t, voxels).

    ``operator @ volume.ravel()`` and ``operator.T @ traces.ravel()`` as for any
    :class:`scipy.sparse.linalg.LinearOperator`; :meth:`forward` and :meth:`backward` take and give arrays, CuPy's where
    they are given some of a GPU. The two are transposes of each other to rounding error; ``tolerance`` is the model's
    relative error against its direct sums.

    Parameters
    ----------
    geometry
        Sensors, their sensitivity, and timing; weights play no part. Several layers are computed on the CPU, and are
        taken to be equally dense where they have no densities.
    grid
        Voxels of the volume, without ``upsampling``, ``depth_step`` and ``time_padding``. ``lateral_padding`` None: as
        much as keeps the periodic copies of the volume out of the record
        (:func:`.geometry.model.artefact_free_padding`), about (aperture + c·duration)/aperture; transforms and memory
        grow by it along each axis. With less, copies are heard: 1 is exact for a medium that repeats.
    response
        The film's response inside the model; None: an ideal sensor.
    max_frequency
        Frequency in Hz above which the model is silent; None: the Nyquist frequency of time.
    tolerance
        Relative error of the model against its direct sums.
    window
        Interpolation window, as in :class:`steradian.imaging.DirectMethod`.
    compute
        Execution options.

    Attributes
    ----------
    tables, chosen
        Tables and engine selection (:mod:`steradian.imaging.engines`).

    Raises
    ------
    InvalidInput
        If a parameter is out of range.
    """

    def __init__(
        self,
        geometry: AcquisitionGeometry,
        grid: ImageGrid,
        *,
        response: FilmResponse | None = None,
        max_frequency: float | None = None,
        tolerance: float = 1e-4,
        window: Shape | Window = "kaiser-bessel",
        compute: Compute = Compute(),
    ) -> None:
        grid.require_defaults("a forward model", "upsampling", "depth_step", "time_padding")
        tolerance = TOLERANCE.check("tolerance", tolerance)
        check_window("window", window)
        if check_max_frequency(max_frequency) == "signal":
            allowed = 'a frequency above 0 Hz, or None; "signal" is for reconstruct()'
            raise InvalidInput("max_frequency", max_frequency, allowed)
        dtype = compute.precision(tolerance)
        settings: dict[str, Any] = {
            "tolerance": tolerance, "window": window, "max_frequency": max_frequency, "response": response
        }  # fmt: skip
        if len(geometry.medium.layers) > 1:
            self.tables, layers = layered_tables(*self.layer_geometries(geometry, grid), dtype, **settings)
            shape = self.tables.geometry
            memory.check_memory(min_bytes(shape, dtype), compute.memory_limit, shape.shape)
            self.chosen = EngineSelector(self.tables, compute, partial(LayeredEngine, layers=layers))
        else:
            shape = model_geometry(geometry, grid)
            memory.check_memory(min_bytes(shape, dtype), compute.memory_limit, shape.shape)
            self.tables = forward_tables(shape, dtype, **settings)
            self.chosen = EngineSelector(self.tables, compute)
        self._attenuation: RealArray | None = None
        if geometry.medium.lossy and len(geometry.medium.layers) == 1:
            timing = {"interval": geometry.dt, "time_zero": geometry.t0}
            self._attenuation = attenuation_matrix(geometry.medium, samples=geometry.samples, **timing).astype(dtype)
        self._sensitivity: RealArray | None = None
        if geometry.sensitivity is not None:
            checked = check_sensitivity(geometry.sensitivity, len(shape.positions))
            self._sensitivity = checked[:, None].astype(dtype)
        size = (len(shape.positions) * shape.samples, int(np.prod(shape.shape)))
        super().__init__(np.dtype(dtype), size)  # type: ignore[call-arg]

    def layer_geometries(
        self, geometry: AcquisitionGeometry, grid: ImageGrid
    ) -> tuple[ReconstructionGeometry, list[LayerGeometry]]:
        """Return the geometry of the volume, and of each of several layers; for subclasses with other slices."""
        return layered_geometries(geometry, grid)

    @property
    def engine(self) -> AnyEngine:
        """Compute engine in use (CPU or GPU)."""
        return self.chosen.engine

    @property
    def volume_shape(self) -> tuple[int, ...]:
        """Shape of volumes, [x, y, z] ([x, z] in 2-D)."""
        return self.geometry.shape

    @property
    def trace_shape(self) -> tuple[int, int]:
        """Shape of A-lines, (M, N_t)."""
        return len(self.geometry.positions), self.geometry.samples

    @property
    def geometry(self) -> ReconstructionGeometry:
        """Validated geometry, with ``shape``, ``spacing`` and ``axes()`` of the volume."""
        return self.tables.geometry

    @property
    def threads(self) -> int:
        """Number of threads of a product."""
        return self.engine.room.threads

    @property
    def memory_bytes(self) -> int:
        """Upper bound of the memory that one product allocates, its result included."""
        more = 0
        if self._attenuation is not None:  # A-lines without attenuation, beside those with it
            more = self._attenuation.nbytes + int(np.prod(self.trace_shape)) * self._attenuation.itemsize
        if self._sensitivity is not None:
            more += int(np.prod(self.trace_shape)) * self._sensitivity.itemsize
        return self.engine.room.memory_bytes + more

    def forward(
        self, volume: ArrayLike, *, progress: Progress | None = None, cancelled: CancelCheck | None = None
    ) -> RealArray:
        """Return the A-lines, shape (M, N_t), of initial pressure [x, y, z] ([x, z] in 2-D).

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
            given = array
            if isinstance(engine, NumbaEngine):
                given = np.ascontiguousarray(to_numpy(array), self.tables.dtype)
            if name == "traces":
                if self._sensitivity is not None:
                    given = given * like(self._sensitivity, given)
                if self._attenuation is not None:
                    given = given @ like(self._attenuation, given)
                return make(engine, given, watch)
            result = make(engine, given, watch)
            if self._attenuation is not None:
                result = result @ like(self._attenuation.T, result)
            if self._sensitivity is not None:
                result *= like(self._sensitivity, result)
            return result

        found: RealArray = self.chosen.run_with_fallback(work, keep=is_gpu_array(values))
        return found
