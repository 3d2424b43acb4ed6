"""CPU engine of the forward model of a layered medium, and its adjoint.

Each layer has an engine of its own, which makes the field at the plane of the layer's first slice, as in one medium. An
:class:`~steradian.imaging.transforms.extrapolation.Extrapolation` takes it, mode by mode, to the film, where the layers
add up. What goes from step to step is the volume itself instead of modes over depth, so that the modes of one layer at
a time are in memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.imaging.compute import memory_limit as memory
from steradian.imaging.compute import thread_pool as workers
from steradian.imaging.engines import NO_MONITOR, ProgressMonitor
from steradian.imaging.engines.numba.engine import NumbaEngine
from steradian.imaging.engines.numba.memory_plan import aligned_empty
from steradian.imaging.layered_tables import LayerTables
from steradian.imaging.transform_tables import TransformTables
from steradian.imaging.transforms.extrapolation import Extrapolation
from steradian.imaging.transforms.lateral import numbers_of
from steradian.imaging.volume import RealArray

_COLUMNS, _NUMBERS = 32, 16  # modes extrapolated together, and what each takes, in samples
_KEPT_BYTES = 2**25  # most that the factors of a layer's modes take to be kept for the next product


class LayeredEngine(NumbaEngine):
    """:class:`~steradian.imaging.engines.Engine` of the forward model of several layers; modes over depth are volumes.

    A product costs one of each layer's own, and for each layer but the first two FFTs of 1.5 times the record, and the
    factor, for each lateral mode; small factors are kept, as a fit makes many products. Memory: the modes at the film,
    those of the largest layer, the volume, and kept factors.

    Parameters
    ----------
    tables
        Sensors and times at the film, and the whole volume.
    layers
        From the film downwards.
    threads, memory_limit
        As in :class:`NumbaEngine`.

    Raises
    ------
    InvalidInput
        If the memory needed exceeds the limit, or what is available.
    """

    def __init__(
        self,
        tables: TransformTables,
        *,
        layers: Sequence[LayerTables],
        threads: int,
        memory_limit: int | None = None,
    ) -> None:
        super().__init__(tables, threads=threads, memory_limit=memory_limit)
        self._layers = [
            (NumbaEngine(layer.tables, threads=threads, memory_limit=memory_limit), layer) for layer in layers
        ]
        item = np.dtype(tables.dtype).itemsize
        spectra = [each.extrapolation.length if each.extrapolation else each.tables.time.samples for each in layers]
        # numbers of a piece of each thread, for a mode and a sample: lines, spectra, the factor, and copies of them
        scratch = threads * _COLUMNS * max(spectra) * _NUMBERS * item
        largest = max(engine.room.memory_bytes + engine.room.output_bytes for engine, _ in self._layers)
        self._squares = _squares(tables)
        self._order = np.argsort(self._squares, kind="stable")  # modes of the same |k| share the factor
        self._ways = [
            None if each.extrapolation is None else _Extrapolator(each.extrapolation, tables.dtype, self._squares.size)
            for each in layers
        ]
        kept = sum(way.kept_bytes for way in self._ways if way is not None)
        needed = self.room.memory_bytes + largest + self.room.output_bytes + scratch + kept
        self.room = replace(self.room, memory_bytes=needed)
        memory.check_memory(needed, memory_limit, tables.geometry.shape)

    def to_image_adjoint(self, image: RealArray, watch: ProgressMonitor = NO_MONITOR) -> RealArray:
        """Return the volume as it is: :meth:`to_depth_adjoint` makes modes of one layer at a time."""
        return image

    def to_depth_adjoint(self, modes: RealArray, watch: ProgressMonitor = NO_MONITOR) -> RealArray:
        """Return the modes over time at the film of a volume."""
        film: RealArray = aligned_empty(self.room.source_size, self.tables.dtype)
        film[:] = 0
        for number, (engine, layer) in enumerate(self._layers, start=1):
            part = watch.of_layer(number, len(self._layers))
            some = np.ascontiguousarray(modes[..., slice(*layer.slices)])
            field = engine.to_depth_adjoint(engine.to_image_adjoint(some, part), part)
            self._take(number - 1, engine.room.rows(field), self.room.rows(film), part, adjoint=False)
        return film

    def to_depth(self, modes: RealArray, watch: ProgressMonitor = NO_MONITOR, *, kept: bool = False) -> RealArray:
        """Return the volume of modes over time at the film, which are not changed: adjoint of the above."""
        volume: RealArray = np.empty(self.tables.geometry.shape, self.tables.dtype)
        for number, (engine, layer) in enumerate(self._layers, start=1):
            part = watch.of_layer(number, len(self._layers))
            field: RealArray = aligned_empty(engine.room.source_size, self.tables.dtype)
            self._take(number - 1, self.room.rows(modes), engine.room.rows(field), part, adjoint=True)
            volume[..., slice(*layer.slices)] = engine.to_image(engine.to_depth(field, part), part)
        return volume

    def to_image(self, modes: RealArray, watch: ProgressMonitor = NO_MONITOR) -> RealArray:
        """Return the volume as it is: :meth:`to_depth` has made it."""
        return modes

    def _take(
        self, number: int, source: RealArray, target: RealArray, watch: ProgressMonitor, *, adjoint: bool
    ) -> None:
        """Add a layer's field to the film's rows; or put the adjoint of the film's rows into a field's."""
        (_, layer), way = self._layers[number], self._ways[number]
        matrix = None if layer.attenuation is None else layer.attenuation.astype(self.tables.dtype)
        own, heard = layer.tables.time.samples, self.tables.time.samples

        def work(piece: int, factor: NDArray[Any], flag: NDArray[np.uint8]) -> None:
            rows: slice | NDArray[np.int64]
            first, end = piece * _COLUMNS, min((piece + 1) * _COLUMNS, len(self._order))
            columns, rows = self._order[first:end], slice(2 * first, 2 * end)  # in any order, unless extrapolated
            if way is not None:
                rows = (2 * columns[:, None] + np.arange(2)).ravel()
            line = source[rows, : heard if adjoint else own]
            if way is not None and adjoint:
                line = way.backward(line, way.factor(piece, self._squares[columns], factor))
            if matrix is not None:
                line = line @ (matrix if adjoint else matrix.T)
            if way is not None and not adjoint:
                line = way.forward(line, way.factor(piece, self._squares[columns], factor))
            if adjoint:
                target[rows, :own] = line
            else:
                target[rows, :heard] += line

        def scratch() -> NDArray[Any]:
            count = 0 if way is None else len(way.shift)
            return np.empty((_COLUMNS, count), np.result_type(self.tables.dtype, np.complex64))

        pieces = -(-len(self._order) // _COLUMNS)
        workers.parallel_for("layers above", pieces, scratch, work, threads=self.room.threads, **watch._asdict())


class _Extrapolator:
    """Extrapolation of rows of samples, real and imaginary parts of modes in turn, and its adjoint."""

    def __init__(self, way: Extrapolation, dtype: str, modes: int) -> None:
        self._way = way
        self._skipped = max(0, -way.first)  # samples before the pulse hear nothing
        self._heard = slice(way.first + self._skipped, way.first + way.samples)
        self._decay, self._growth = way.decay.astype(dtype), way.growth[self._skipped :].astype(dtype)
        self.shift = way.shift
        size = modes * len(way.shift) * np.result_type(dtype, np.complex64).itemsize
        self.kept_bytes = size if size <= _KEPT_BYTES else 0
        self._kept: dict[int, NDArray[Any]] = {}

    def factor(self, piece: int, squares: NDArray[np.float64], scratch: NDArray[Any]) -> NDArray[Any]:
        """Return the factor of the modes of a piece, which have |k|² ``squares``, at each frequency."""
        if piece in self._kept:
            return self._kept[piece]
        from steradian.imaging.engines.numba.extrapolation import transfer

        distinct, which = np.unique(squares, return_inverse=True)
        transfer(distinct, self._way.slowness, self._way.path, self.shift, scratch)
        found: NDArray[Any] = scratch[which]
        if self.kept_bytes:
            self._kept[piece] = found
        return found

    def forward(self, rows: RealArray, factor: NDArray[Any]) -> RealArray:
        """Return the film's samples of modes from those at the plane, by their factor."""
        line = np.zeros((len(rows), self._way.length), rows.dtype)
        line[:, : self._way.source] = rows * self._decay
        found = np.zeros((len(rows), self._way.samples), rows.dtype)
        found[:, self._skipped :] = self._filtered(line, factor)[:, self._heard] * self._growth
        return found

    def backward(self, rows: RealArray, factor: NDArray[Any]) -> RealArray:
        """Apply the adjoint of :meth:`forward`."""
        line = np.zeros((len(rows), self._way.length), rows.dtype)
        line[:, self._heard] = rows[:, self._skipped :] * self._growth
        found: RealArray = self._filtered(line, np.conj(factor))[:, : self._way.source] * self._decay
        return found

    def _filtered(self, line: RealArray, factor: NDArray[Any]) -> RealArray:
        from scipy import fft

        spectrum = fft.rfft(line, axis=1, overwrite_x=True).reshape(len(factor), 2, -1)
        spectrum *= factor[:, None]
        found: RealArray = fft.irfft(spectrum.reshape(len(line), -1), self._way.length, axis=1, overwrite_x=True)
        return found


def _squares(tables: TransformTables) -> NDArray[np.float64]:
    """Return |k|² in 1/m² of each stored mode."""
    (nx, ny), period = tables.lateral.modes, (1.0, *tables.geometry.period)[-2:]
    x, y = (2 * np.pi * numbers_of(n) / side for n, side in zip((nx, ny), period, strict=True))
    return (x**2 + y[: ny // 2 + 1, None] ** 2).ravel()
