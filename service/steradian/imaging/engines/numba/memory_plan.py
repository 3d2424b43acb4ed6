"""Memory plan of the CPU engine: row strides, buffer sharing and size bounds."""

from __future__ import annotations

from dataclasses import dataclass
from math import prod

import numpy as np

from steradian.imaging.engines.numba.constants import CACHE_LINE_BYTES, CELL_PADDING
from steradian.imaging.engines.numba.fft_tables import table_bytes
from steradian.imaging.engines.numba.kernel_args import StoredModes
from steradian.imaging.engines.numba.kernel_tables import row_count
from steradian.imaging.geometry.reconstruction import ReconstructionGeometry
from steradian.imaging.transform_tables import TransformTables
from steradian.imaging.volume import RealArray

_COLUMN_BYTES, _SAMPLE_BYTES = 290, 900  # of tables while they are made, for a lateral mode and for a sample, at least


@dataclass(frozen=True, slots=True)
class MemoryPlan:
    """Layout of the modes as rows of one flat array, with a spare row for unused lanes.

    Parameters
    ----------
    source_rows, source_stride
        Of the modes over time; strides are multiples of 16.
    target_rows, target_stride
        Of the modes over depth: the same, where they take the place of their own times.
    shared
        The image may overwrite the modes' depths, batch by batch.
    threads
        At most; fewer than asked for if their scratch space would exceed half of the image, or of the modes.
    output_bytes, kept_bytes
        Size of the image, and of the array that it is a view of.
    memory_bytes
        Bound of what one pass through all steps allocates, its result included.
    """

    source_rows: int
    source_stride: int
    target_rows: int
    target_stride: int
    shared: bool
    threads: int
    output_bytes: int
    kept_bytes: int
    memory_bytes: int

    @property
    def source_size(self) -> int:
        """Number of elements of the modes over time."""
        return (self.source_rows + 1) * self.source_stride

    @property
    def target_size(self) -> int:
        """Number of elements of the modes over depth."""
        return (self.target_rows + 1) * self.target_stride

    def rows(self, modes: RealArray) -> RealArray:
        """Return modes over time as rows, real and imaginary part of each in turn, without the spare row."""
        return modes.reshape(-1, self.source_stride)[:-1]

    def relaid(self, modes: RealArray, other: MemoryPlan, samples: int) -> RealArray:
        """Return modes over time in another plan's layout, of the same sensors and ``samples``, in this one's."""
        found = aligned_empty(self.source_size, modes.dtype.name)
        self.rows(found)[:, :samples] = other.rows(modes)[:, :samples]
        return found


def aligned_empty(count: int, dtype: str) -> RealArray:
    """Allocate ``count`` elements aligned to a cache line, so that no SIMD vector crosses two lines."""
    item = np.dtype(dtype).itemsize
    numbers = np.empty(count + CACHE_LINE_BYTES // item, dtype)
    first = -numbers.ctypes.data % CACHE_LINE_BYTES // item
    return numbers[first : first + count]


def round_up_to_vector(count: int) -> int:
    """Return ``count`` rounded up to a multiple of 16, the length of a row of whole SIMD vectors."""
    return -(-count // 16) * 16


def plan_memory(tables: TransformTables, stored: StoredModes, threads: int) -> MemoryPlan:
    """Return the memory layout, number of threads and memory bound of the CPU engine."""
    samples, depths, (nx, ny) = tables.time.samples, tables.depths, tables.lateral.modes
    item = np.dtype(tables.dtype).itemsize
    out_rows = prod(tables.geometry.shape[:-1])
    mode_rows, source_rows = 2 * nx * (ny // 2 + 1), row_count(stored)
    # where the modes' depths go: over their own times, or (replicated) to a place of their own
    replicated = tables.lateral.replicated
    source_stride = round_up_to_vector(samples if replicated else max(samples, depths))
    target_stride = round_up_to_vector(depths) if replicated else source_stride
    target_rows = mode_rows if replicated else source_rows
    shared = target_stride == round_up_to_vector(depths) and out_rows <= target_rows
    image, kept = out_rows * depths * item, out_rows * round_up_to_vector(depths) * item
    source, target = ((r + 1) * s * item for r, s in ((source_rows, source_stride), (target_rows, target_stride)))
    scratch = scratch_elements(tables, stored) * item
    threads = int(max(1, min(threads, max(scratch, max(image, source, target) // 2) // max(scratch, 1))))
    if tables.transposable:  # A-lines may be the result, and are made beside the modes
        needed = target + max(0 if shared else kept, len(tables.lateral.scale) * samples * item)
    else:  # a source of its own is freed before the image is made
        needed = max((source if replicated else 0) + target, target + (0 if shared else kept))
    if tables.decimation is not None:
        needed += tables.decimation.bytes(len(tables.lateral.scale), threads, tables.dtype)
    return MemoryPlan(
        source_rows, source_stride, target_rows, target_stride, shared, threads, image, target if shared else kept,
        needed + threads * scratch,
    )  # fmt: skip


def min_bytes(g: ReconstructionGeometry, dtype: str) -> int:
    """Return a lower bound of the memory of tables and a run, before any large allocation."""
    nx, ny = (1, *g.padded_modes)[-2:]
    columns = nx * (ny // 2 + 1)
    tables = columns * _COLUMN_BYTES + g.samples * _SAMPLE_BYTES
    sizes = {g.depth_points, *(n * g.upsampling for n in g.padded_modes)}
    tables += sum(table_bytes(n) for n in sizes)
    image = max(2 * columns, prod(g.shape[:-1])) * g.shape[-1] * np.dtype(dtype).itemsize
    return max(tables, image)


def scratch_elements(tables: TransformTables, stored: StoredModes) -> int:
    """Return an upper bound of the elements of scratch memory of a thread."""
    (nx, ny), (ix, iy) = tables.lateral.grid, tables.image_modes
    line, half = max(nx, ny + CELL_PADDING), len(stored.ys)
    packed = len(tables.lateral.scale)
    if tables.transposable:  # types 1 and 2, and the image's points as sensors
        lines, middle = 5 * max(line, ix, iy + CELL_PADDING), 2 * half * (max(nx, ix) | 1)
        lateral = max(packed, prod(tables.geometry.shape[:-1])) + lines + middle
    else:
        lateral = packed + 2 * line + 2 * half * (nx | 1)
    image = 4 * max(ix, iy) + tables.visible_region[0][1] * (iy | 1)
    aligned = 8  # cells: what :func:`aligned_empty` leaves out
    columns = 2 * (max(tables.time.length, tables.geometry.depth_points) + 2 * CELL_PADDING) + 200
    return 32 * (aligned + max(lateral, image, columns))
