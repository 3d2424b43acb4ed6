"""Inverse and forward FFTs between modes and image, in one pass or in chunks."""

from __future__ import annotations

from typing import Any

import numpy as np

from steradian.imaging.compute import thread_pool as workers
from steradian.imaging.engines import ProgressMonitor
from steradian.imaging.engines.cuda.array_backend import Backend
from steradian.imaging.engines.cuda.memory_plan import MemoryPlan
from steradian.imaging.transform_tables import TransformTables


def image_of_spectrum(tables: TransformTables, backend: Backend, modes: Any) -> Any:
    """Return the image of normalised modes over depth, which are overwritten."""
    (x, nx), (y, ny) = tables.visible_region
    first, last = tables.geometry.depth
    for axis, count in enumerate(tables.image_modes):
        modes = refined(backend.xp, modes, axis, count)
    axes = (*lateral_axes(modes.shape[0]), 2)
    size = (*tables.image_modes, tables.geometry.depth_points)[-len(axes) :]
    image = backend.fft.irfftn(modes, s=size, axes=axes, overwrite_x=True, norm="forward")
    shown = backend.xp.ascontiguousarray(image[x : x + nx, y : y + ny, first:last])
    return shown.reshape(tables.geometry.shape)


def image_in_chunks(
    tables: TransformTables, backend: Backend, room: MemoryPlan, modes: Any, watch: ProgressMonitor
) -> Any:
    """Compute the image chunk by chunk, with modes and image on the host: along y first, then along x and z."""
    (x, nx), (y, ny), (fx, fy) = *tables.visible_region, tables.image_modes
    (first, last), points = tables.geometry.depth, tables.geometry.depth_points
    between = np.empty((modes.shape[0], ny, modes.shape[2]), modes.dtype)
    image = np.empty((nx, ny, last - first), tables.dtype)

    def along_y(piece: int) -> None:
        some = slice(piece * room.rows, (piece + 1) * room.rows)
        part = refined(backend.xp, backend.array(modes[some]), 1, fy)
        between[some] = backend.host(backend.fft.ifft(part, axis=1, norm="forward")[:, y : y + ny])

    def along_x(piece: int) -> None:
        some = slice(piece * room.columns, (piece + 1) * room.columns)
        part = refined(backend.xp, backend.array(between[:, some]), 0, fx)
        part = backend.fft.ifft(part, axis=0, norm="forward")[x : x + nx]
        image[:, some] = backend.host(backend.fft.irfft(part, points, axis=2, norm="forward")[:, :, first:last])

    run_chunks("image", -(-modes.shape[0] // room.rows), along_y, watch)
    run_chunks("image", -(-ny // room.columns), along_x, watch)
    return image.reshape(tables.geometry.shape)


def spectrum_of_image(tables: TransformTables, backend: Backend, image: Any) -> Any:
    """Return the modes over depth of an image."""
    around = _embedded(tables, backend.xp, image)
    return backend.xp.ascontiguousarray(backend.fft.rfftn(around, axes=(*lateral_axes(around.shape[0]), 2)))


def lateral_axes(lines: int) -> tuple[int, ...]:
    """Return the axes to transform: x and y in 3-D, one in 2-D."""
    return (0, 1) if lines > 1 else (1,)


def _embedded(tables: TransformTables, xp: Any, image: Any) -> Any:
    """Return a zero-padded image."""
    (x, nx), (y, ny) = tables.visible_region
    first, last = tables.geometry.depth
    values = image.reshape(nx, ny, last - first)
    size = (*tables.image_modes, tables.geometry.depth_points)
    if values.shape == size:
        return values
    around = xp.zeros(size, values.dtype)
    around[x : x + nx, y : y + ny, first:last] = values
    return around


def spectrum_in_chunks(
    tables: TransformTables, backend: Backend, room: MemoryPlan, image: Any, watch: ProgressMonitor
) -> Any:
    """Compute the modes over depth chunk by chunk, image and modes on the host: z and x first, then y."""
    xp, ((x, nx), (y, ny)), (fx, fy) = backend.xp, tables.visible_region, tables.image_modes
    (first, last), points = tables.geometry.depth, tables.geometry.depth_points
    values = backend.host(image).reshape(nx, ny, last - first)
    kind = np.complex64 if tables.dtype == "float32" else np.complex128
    between = np.empty((fx, ny, points // 2 + 1), kind)
    modes = np.empty((fx, fy, points // 2 + 1), kind)

    def along_x(piece: int) -> None:
        some = slice(piece * room.columns, (piece + 1) * room.columns)
        part = backend.array(values[:, some], tables.dtype)
        around = xp.zeros((fx, part.shape[1], points), part.dtype)
        around[x : x + nx, :, first:last] = part
        between[:, some] = backend.host(backend.fft.fft(backend.fft.rfft(around, axis=2), axis=0))

    def along_y(piece: int) -> None:
        some = slice(piece * room.rows, (piece + 1) * room.rows)
        part = backend.array(between[some])
        around = xp.zeros((part.shape[0], fy, part.shape[2]), kind)
        around[:, y : y + ny] = part
        modes[some] = backend.host(backend.fft.fft(around, axis=1))

    run_chunks("lateral transform", -(-ny // room.columns), along_x, watch)
    run_chunks("lateral transform", -(-fx // room.rows), along_y, watch)
    return modes


def refined(xp: Any, modes: Any, axis: int, count: int) -> Any:
    """Zero-pad modes to ``count`` ≥ N points; the mode at −N/2 is split evenly with +N/2."""
    n = modes.shape[axis]
    if count == n:
        return modes
    shape = list(modes.shape)
    shape[axis] = count
    fine = xp.zeros(shape, modes.dtype)
    low, high = (n + 1) // 2, n // 2

    def some(*bounds: int | None) -> tuple[slice, ...]:
        return (slice(None),) * axis + (slice(*bounds),)

    fine[some(0, low)] = modes[some(0, low)]
    fine[some(count - high, None)] = modes[some(low, None)]
    if n % 2 == 0:
        fine[some(count - high, count - high + 1)] *= 0.5
        fine[some(high, high + 1)] = modes[some(low, low + 1)] * 0.5
    return fine


def run_chunks(stage: str, pieces: int, work: Any, watch: ProgressMonitor) -> None:
    """Run the chunks of work in sequence with progress and cancellation."""
    workers.parallel_for(stage, pieces, lambda: None, lambda piece, *_: work(piece), threads=1, **watch._asdict())
