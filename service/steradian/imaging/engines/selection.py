"""Engine selection: CPU or GPU, with fallback when GPU memory is insufficient."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from steradian.core.exceptions import InvalidInput
from steradian.imaging.engines.array_namespace import is_gpu_array
from steradian.imaging.engines.numba.engine import NumbaEngine
from steradian.imaging.options import Compute
from steradian.imaging.transform_tables import TransformTables

if TYPE_CHECKING:
    from steradian.imaging.engines.cuda.engine import CudaEngine

AnyEngine: TypeAlias = "NumbaEngine | CudaEngine"


class EngineSelector:
    """Selector of the CPU or GPU engine according to the execution options.

    Parameters
    ----------
    tables
        What to compute.
    compute
        Execution options.
    on_processor
        Constructor of an engine that there is for the processor only; None: there is one for both.

    Attributes
    ----------
    engine
        The engine at present.
    notes
        What to know of the choice: that and why it is not what was asked for.

    Raises
    ------
    InvalidInput
        If the device asked for is not there, or memory does not suffice.
    """

    def __init__(
        self, tables: TransformTables, compute: Compute, on_processor: Callable[..., NumbaEngine] | None = None
    ) -> None:
        self._tables, self._compute, self._only = tables, compute, on_processor
        self.notes: list[str] = []
        self.engine: AnyEngine = self._first()

    @property
    def device(self) -> str:
        """Name of the GPU, or "cpu"."""
        return "cpu" if isinstance(self.engine, NumbaEngine) else self.engine.backend.name

    @property
    def resident(self) -> bool:
        """Whether images remain in GPU memory."""
        return not isinstance(self.engine, NumbaEngine) and self.engine.room.fits_in_one_pass

    def as_engine_array(self, field: str, values: Any) -> Any:
        """Convert an array: GPU arrays to CuPy without a copy, anything else to NumPy.

        Raises
        ------
        InvalidInput
            If it is of a GPU and the engine is not.
        """
        if not is_gpu_array(values):
            return np.asarray(values)
        if isinstance(self.engine, NumbaEngine):
            raise InvalidInput(field, "an array of a GPU", "an array in memory, or the device gpu")
        return self.engine.backend.array(values)

    def run_with_fallback(self, work: Callable[[AnyEngine], Any], *, keep: bool) -> Any:
        """Run a function with the engine, on the CPU if GPU memory is full; return its result.

        Where the GPU's memory turns out too small, the work is done again with half as much of it, in pieces, and at
        last, with "auto", by the processor; what is to be kept on the GPU has to fit.

        Raises
        ------
        InvalidInput
            If the GPU's memory does not suffice.
        """
        while True:
            engine = self.engine
            if keep and not self.resident:
                raise self._too_small()
            try:
                found = work(engine)
                return found if keep or isinstance(engine, NumbaEngine) else engine.host(found)
            except Exception as error:
                if not self.is_full(error):
                    raise
            if keep or isinstance(engine, NumbaEngine):
                raise self._too_small()
            self._fall_back(engine)  # not earlier: until here the error holds what was computed

    def run_on_device(self, work: Callable[[Any], Any], values: Any) -> Any:
        """Run a function on an array copied to the GPU; on the original array if GPU memory is full."""
        try:
            assert not isinstance(self.engine, NumbaEngine)  # noqa: S101
            return work(self.engine.array(values))
        except Exception as error:
            if not (self.is_full(error) or (isinstance(error, InvalidInput) and error.field == "device_memory")):
                raise
        self.notes.append("the GPU's memory was full; images were kept outside it")
        return work(values)

    def is_full(self, error: BaseException) -> bool:
        """Return whether an exception means that GPU memory is full."""
        return not isinstance(self.engine, NumbaEngine) and self.engine.backend.is_out_of_memory(error)

    def _too_small(self) -> InvalidInput:
        allowed = "more of the GPU's memory for its own arrays; with arrays in memory it works in pieces"
        return InvalidInput("device_memory", self._compute.device_memory, allowed)

    def _first(self) -> AnyEngine:
        wanted = self._compute.device
        if self._only is not None and wanted == "gpu":
            raise InvalidInput("device", wanted, "cpu or auto for a forward model of several layers")
        if self._only is not None or wanted == "cpu":
            return self._of_processor()
        from steradian.imaging.engines.cuda.array_backend import unavailable_reason

        lacking = unavailable_reason()
        if wanted == "auto" and lacking is not None:
            return self._of_processor()
        try:
            return self._of_gpu(self._compute.device_memory)
        except InvalidInput as error:
            if wanted == "gpu" or error.field != "device_memory":
                raise
            self.notes.append(f"computed on the processor, the GPU's memory being too small: {error}")
            return self._of_processor()

    def _fall_back(self, engine: CudaEngine) -> None:
        engine.backend.release()
        half = engine.room.device_bytes // 2
        try:
            self.engine = self._of_gpu(half)
            self.notes.append(f"the GPU's memory was full; done again in pieces within {half} bytes of it")
        except InvalidInput:
            if self._compute.device == "gpu":
                raise
            self.engine = self._of_processor()
            self.notes.append("the GPU's memory was full; done again on the processor")

    def _of_gpu(self, device_memory: int | None) -> CudaEngine:
        from steradian.imaging.engines.cuda.engine import CudaEngine

        return CudaEngine(self._tables, device_memory=device_memory, memory_limit=self._compute.memory_limit)

    def _of_processor(self) -> NumbaEngine:
        compute = self._compute
        make = self._only or NumbaEngine
        return make(self._tables, threads=compute.max_threads, memory_limit=compute.memory_limit)
