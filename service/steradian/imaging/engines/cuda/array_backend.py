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
    """Protocol of the array backend of one device: arrays, FFTs and kernel launches."""

    @property
    def name(self) -> str:
        """Name of the device."""

    @property
    def xp(self) -> Any:
        """NumPy-compatible array namespace of the device."""

    @property
    def fft(self) -> Any:
        """FFT module of the device, like :mod:`scipy.fft`."""

    def array(self, values: Any, dtype: str | None = None) -> Any:
        """Return an array on the device; an array already there is not copied."""

    def table(self, values: NDArray[Any]) -> Any:
        """Return a lookup table on the device, in the kernels' argument form."""

    def host(self, values: Any) -> NDArray[Any]:
        """Copy an array from the device to a NumPy array."""

    def launch(self, kernel: Any, size: tuple[int, int], *arguments: Any) -> None:
        """Launch a kernel with about one thread for each of ``size`` elements; x is the fast axis."""

    def free(self) -> int:
        """Return the bytes of device memory available to this process."""

    def release(self) -> None:
        """Release cached device memory: FFT work areas and freed arrays."""

    def wait(self) -> None:
        """Wait until all work started on the device has finished."""

    def is_out_of_memory(self, error: BaseException) -> bool:
        """Return whether an exception means that the device is out of memory."""


class CupyBackend:
    """CuPy backend of the current CUDA device."""

    def __init__(self) -> None:
        self._cuda = importlib.import_module("numba.cuda")
        self.xp = importlib.import_module("cupy")
        self.fft = importlib.import_module("cupyx.scipy.fft")
        self._pinned = importlib.import_module("cupyx").empty_pinned
        _without_warnings()

    @property
    def name(self) -> str:
        """Name of the GPU as the CUDA driver reports it."""
        runtime = self.xp.cuda.runtime
        return str(runtime.getDeviceProperties(runtime.getDevice())["name"].decode())

    def array(self, values: Any, dtype: str | None = None) -> Any:
        """Return a contiguous CuPy array; arrays of other libraries are exchanged by DLPack."""
        if not isinstance(values, np.ndarray | self.xp.ndarray) and hasattr(values, "__dlpack__"):
            values = (self.xp if values.__dlpack_device__()[0] == _CUDA else np).from_dlpack(values)
        return self.xp.ascontiguousarray(self.xp.asarray(values), dtype=dtype)

    def table(self, values: NDArray[Any]) -> Any:
        """Return a lookup table as Numba device array, once, because views at each launch would be slow."""
        return self._seen(self.array(values))

    def host(self, values: Any) -> NDArray[Any]:
        """Copy an array from the device to pinned host memory, for the full transfer rate."""
        if isinstance(values, np.ndarray):
            return values
        target: NDArray[Any] = self._pinned(values.shape, values.dtype)
        values.get(out=target)
        return target

    def launch(self, kernel: Any, size: tuple[int, int], *arguments: Any) -> None:
        """Launch a CUDA kernel on CuPy's current stream."""
        across = 32
        while across < min(_THREADS, size[0]):
            across *= 2
        block = (across, _THREADS // across)
        grid = (-(-size[0] // block[0]), min(_MOST_BLOCKS, -(-size[1] // block[1])))
        stream = self.xp.cuda.get_current_stream().ptr
        how = (grid, block, self._cuda.external_stream(stream)) if stream else (grid, block)
        kernel[how](*(self._seen(argument) for argument in arguments))

    def _seen(self, argument: Any) -> Any:
        """Convert CuPy arrays to Numba device arrays without synchronisation, because both use one stream."""
        if isinstance(argument, self.xp.ndarray):
            return self._cuda.from_cuda_array_interface(argument.__cuda_array_interface__, owner=argument, sync=False)
        if hasattr(argument, "_fields"):
            return type(argument)(*(self._seen(each) for each in argument))
        return argument

    def free(self) -> int:
        """Return the free bytes of device memory, including those of CuPy's memory pool."""
        return int(self.xp.cuda.Device().mem_info[0]) + int(self.xp.get_default_memory_pool().free_bytes())

    def release(self) -> None:
        """Clear CuPy's FFT plan cache and memory pool."""
        self.xp.fft.config.get_plan_cache().clear()
        self.xp.get_default_memory_pool().free_all_blocks()

    def wait(self) -> None:
        """Synchronise with the device."""
        self.xp.cuda.Device().synchronize()

    def is_out_of_memory(self, error: BaseException) -> bool:
        """Return whether an exception is CuPy's, cuFFT's or CUDA's out-of-memory error."""
        no_room = importlib.import_module("cupy.cuda.cufft").CuFFTError, self.xp.cuda.runtime.CUDARuntimeError
        if isinstance(error, self.xp.cuda.memory.OutOfMemoryError):
            return True
        return isinstance(error, no_room) and "ALLOC" in str(error).upper()


class SimulatorBackend:
    """Backend on Numba's CUDA simulator, for tests without a GPU; with a configurable amount of memory."""

    def __init__(self, memory: int = 1 << 30) -> None:
        if os.environ.get("NUMBA_ENABLE_CUDASIM") != "1":
            raise RuntimeError("the simulator is on only if NUMBA_ENABLE_CUDASIM=1 before Numba is imported")
        self.name, self.xp, self.fft = "simulator", np, importlib.import_module("scipy.fft")
        self._memory = memory

    def array(self, values: Any, dtype: str | None = None) -> Any:
        """Return a contiguous NumPy array."""
        return np.ascontiguousarray(values, dtype)

    def table(self, values: NDArray[Any]) -> Any:
        """Return a lookup table as NumPy array."""
        return self.array(values)

    def host(self, values: Any) -> NDArray[Any]:
        """Return a NumPy array of the simulated device's array."""
        return np.asarray(values)

    def launch(self, kernel: Any, size: tuple[int, int], *arguments: Any) -> None:
        """Launch a kernel on the simulator with few threads, because simulated threads are slow."""
        kernel[(2, 1), (1, 2)](*arguments)

    def free(self) -> int:
        """Return the configured bytes of memory."""
        return self._memory

    def release(self) -> None:
        """Release cached memory; the simulator does not cache any."""

    def wait(self) -> None:
        """Wait for the device; the simulator runs synchronously."""

    def is_out_of_memory(self, error: BaseException) -> bool:
        """Return whether an exception means that the simulated device is out of memory."""
        return isinstance(error, MemoryError)


def unavailable_reason() -> str | None:
    """Return the reason why GPU computation is unavailable; None if it is available."""
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
    """Return the backend of the current CUDA device.

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
    """Disable Numba's low-occupancy warnings, which are irrelevant for small images."""
    for name in ("numba.cuda.core.config", "numba.core.config"):
        try:
            importlib.import_module(name).CUDA_LOW_OCCUPANCY_WARNINGS = 0  # type: ignore[attr-defined]
        except ImportError:
            continue
