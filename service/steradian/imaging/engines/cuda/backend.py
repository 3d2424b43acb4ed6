"""Array backend of the CUDA engine: memory, FFT and kernel launches of CuPy or Numba's simulator.

On a device that is CuPy, and Numba compiles the kernels. Under Numba's simulator (``NUMBA_ENABLE_CUDASIM=1``) it is
NumPy and SciPy: the same kernels and the same order of steps, in Python and slow.
"""

from __future__ import annotations

import importlib
import os
from importlib.util import find_spec
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput

_THREADS = 256  # of a block
_MOST_BLOCKS = 65_535  # along y
_CUDA = 2  # DLPack's number of it
USE_SIMULATOR = "STERADIAN_GPU"
"""Variable of the environment that, being "simulator", lets Numba's simulator stand for a GPU."""


class Backend(Protocol):
    """Arrays, transforms and launches of one device."""

    @property
    def name(self) -> str:
        """Of the device."""

    @property
    def xp(self) -> Any:
        """Namespace of its arrays, like NumPy's."""

    @property
    def fft(self) -> Any:
        """Module of transforms, like :mod:`scipy.fft`."""

    def array(self, values: Any, dtype: str | None = None) -> Any:
        """Array on the device; one that is there already is not copied."""

    def table(self, values: NDArray[Any]) -> Any:
        """Array on the device that kernels read again and again, in their form."""

    def host(self, values: Any) -> NDArray[Any]:
        """NumPy array of an array on the device."""

    def launch(self, kernel: Any, size: tuple[int, int], *arguments: Any) -> None:
        """Start a kernel with about one thread for each of ``size`` numbers; x is the faster axis."""

    def free(self) -> int:
        """Bytes of the device that this process may still take."""

    def release(self) -> None:
        """Release cached memory: work areas of transforms and freed arrays."""

    def wait(self) -> None:
        """Wait until all that was started is done."""

    def is_out_of_memory(self, error: BaseException) -> bool:
        """Whether an error says that the device has no memory left."""


class CupyBackend:
    """The current CUDA device."""

    def __init__(self) -> None:
        self._cuda = importlib.import_module("numba.cuda")
        self.xp = importlib.import_module("cupy")
        self.fft = importlib.import_module("cupyx.scipy.fft")
        self._pinned = importlib.import_module("cupyx").empty_pinned
        _without_warnings()

    @property
    def name(self) -> str:
        """As the driver says."""
        runtime = self.xp.cuda.runtime
        return str(runtime.getDeviceProperties(runtime.getDevice())["name"].decode())

    def array(self, values: Any, dtype: str | None = None) -> Any:
        """See :class:`Backend`."""
        if not isinstance(values, np.ndarray | self.xp.ndarray) and hasattr(values, "__dlpack__"):
            values = (self.xp if values.__dlpack_device__()[0] == _CUDA else np).from_dlpack(values)
        return self.xp.ascontiguousarray(self.xp.asarray(values), dtype=dtype)

    def table(self, values: NDArray[Any]) -> Any:
        """See :class:`Backend`; to be made at each launch, views would cost more than small kernels take."""
        return self._seen(self.array(values))

    def host(self, values: Any) -> NDArray[Any]:
        """See :class:`Backend`; into pinned memory, which the device fills at the full rate of its link."""
        if isinstance(values, np.ndarray):
            return values
        target: NDArray[Any] = self._pinned(values.shape, values.dtype)
        values.get(out=target)
        return target

    def launch(self, kernel: Any, size: tuple[int, int], *arguments: Any) -> None:
        """See :class:`Backend`."""
        across = 32
        while across < min(_THREADS, size[0]):
            across *= 2
        block = (across, _THREADS // across)
        grid = (-(-size[0] // block[0]), min(_MOST_BLOCKS, -(-size[1] // block[1])))
        stream = self.xp.cuda.get_current_stream().ptr
        how = (grid, block, self._cuda.external_stream(stream)) if stream else (grid, block)
        kernel[how](*(self._seen(argument) for argument in arguments))

    def _seen(self, argument: Any) -> Any:
        """Return CuPy arrays as Numba's without synchronisation, because both use one stream."""
        if isinstance(argument, self.xp.ndarray):
            return self._cuda.from_cuda_array_interface(argument.__cuda_array_interface__, owner=argument, sync=False)
        if hasattr(argument, "_fields"):
            return type(argument)(*(self._seen(each) for each in argument))
        return argument

    def free(self) -> int:
        """See :class:`Backend`."""
        return int(self.xp.cuda.Device().mem_info[0]) + int(self.xp.get_default_memory_pool().free_bytes())

    def release(self) -> None:
        """See :class:`Backend`."""
        self.xp.fft.config.get_plan_cache().clear()
        self.xp.get_default_memory_pool().free_all_blocks()

    def wait(self) -> None:
        """See :class:`Backend`."""
        self.xp.cuda.Device().synchronize()

    def is_out_of_memory(self, error: BaseException) -> bool:
        """See :class:`Backend`."""
        no_room = importlib.import_module("cupy.cuda.cufft").CuFFTError, self.xp.cuda.runtime.CUDARuntimeError
        if isinstance(error, self.xp.cuda.memory.OutOfMemoryError):
            return True
        return isinstance(error, no_room) and "ALLOC" in str(error).upper()


class SimulatorBackend:
    """Numba's simulator; a device with as much memory as one says."""

    def __init__(self, memory: int = 1 << 30) -> None:
        if os.environ.get("NUMBA_ENABLE_CUDASIM") != "1":
            raise RuntimeError("the simulator is on only if NUMBA_ENABLE_CUDASIM=1 before Numba is imported")
        self.name, self.xp, self.fft = "simulator", np, importlib.import_module("scipy.fft")
        self._memory = memory

    def array(self, values: Any, dtype: str | None = None) -> Any:
        """See :class:`Backend`."""
        return np.ascontiguousarray(values, dtype)

    def table(self, values: NDArray[Any]) -> Any:
        """See :class:`Backend`."""
        return self.array(values)

    def host(self, values: Any) -> NDArray[Any]:
        """See :class:`Backend`."""
        return np.asarray(values)

    def launch(self, kernel: Any, size: tuple[int, int], *arguments: Any) -> None:
        """See :class:`Backend`; with few threads, each of which costs as much as thousands of numbers."""
        kernel[(2, 1), (1, 2)](*arguments)

    def free(self) -> int:
        """See :class:`Backend`."""
        return self._memory

    def release(self) -> None:
        """See :class:`Backend`."""

    def wait(self) -> None:
        """See :class:`Backend`."""

    def is_out_of_memory(self, error: BaseException) -> bool:
        """See :class:`Backend`."""
        return isinstance(error, MemoryError)


def unavailable_reason() -> str | None:
    """Return the missing requirement of GPU computation; None if there is none."""
    if os.environ.get(USE_SIMULATOR) == "simulator":
        return None
    lacking = [name for name in ("cupy", "numba_cuda") if find_spec(name) is None]
    if lacking:
        names = " and ".join({"cupy": "CuPy", "numba_cuda": "numba-cuda"}[name] for name in lacking)
        return f"{names} not installed: pip install 'steradian[gpu]'"
    try:
        count = importlib.import_module("cupy").cuda.runtime.getDeviceCount()
    except Exception as error:
        return f"no CUDA device: {error}"
    return None if count else "no CUDA device"


def device() -> Backend:
    """Return the current CUDA device.

    Raises
    ------
    InvalidInput
        Naming what is missing.
    """
    lacking = unavailable_reason()
    if lacking is not None:
        raise InvalidInput("device", "gpu", f"cpu or auto here ({lacking})")
    return SimulatorBackend() if os.environ.get(USE_SIMULATOR) == "simulator" else CupyBackend()


def _without_warnings() -> None:
    """Small images do not fill a device; nothing is wrong with that."""
    for name in ("numba.cuda.core.config", "numba.core.config"):
        try:
            importlib.import_module(name).CUDA_LOW_OCCUPANCY_WARNINGS = 0  # type: ignore[attr-defined]
        except ImportError:
            continue
