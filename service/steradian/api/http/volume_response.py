"""Responses for volume slices, slabs and projections."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal

from fastapi import Response
from numpy.typing import NDArray

from steradian.api.http.array_response import NPY, ArraySlice, InMemoryArray, array_response
from steradian.api.http.conditional import ReadPreconditions, etag_of_file
from steradian.api.http.volume_params import Window, axis_headers, axis_json, converted, max_pool, pyramid_level_for
from steradian.core.exceptions import InvalidInput, NotFound
from steradian.reconstructions.volumes.grid import in_coarser
from steradian.reconstructions.volumes.reader import VolumeReader, stored_volume
from steradian.storage.blobs.interface import BlobStore, result_name
from steradian.storage.data_dir.job_directory import PROJECTIONS, SERIES, VOLUME


@dataclass(frozen=True)
class ProjectionQuery:
    """Query parameters of a projection."""

    axis: Literal["x", "y", "z", "depth"]
    slab: str | None
    max_size: int | None
    dtype: str | None
    window: str | None
    index: int | None = None


@dataclass(frozen=True)
class VolumeQuery:
    """Query parameters of a volume."""

    slice: str | None
    level: int | None
    max_size: int | None
    dtype: str | None
    window: str | None
    index: int | None = None


def projection_response(
    arrays: BlobStore, identifier: str, kind: str, conditions: ReadPreconditions, wish: ProjectionQuery
) -> Response:
    """Return the response with the stored projection of a whole volume, or with the computed one of a slab.

    Raises
    ------
    NotFound
        When there is neither volume nor revision.
    InvalidInput
        When the query is invalid for this volume.
    """
    etag, stored = _stored(arrays, identifier, kind, wish.index)
    conditions.tag(etag, vary="Accept")
    lattice, along = stored.lattice, "z" if wish.axis == "depth" else wish.axis
    if wish.axis == "depth":
        image: NDArray[Any] = stored.depth_of_max(_slab(wish.slab, stored.size(along)))
    elif wish.slab is not None:
        image = stored.slab_mip(along, _slab(wish.slab, stored.size(along)))
    else:
        image = stored.projection(along)
    lattice = lattice.project_out(along)
    level = pyramid_level_for(image.shape, wish.max_size)
    window = _window(wish, stored)
    source = converted(InMemoryArray(max_pool(image, 2**level)), wish.dtype, window)
    coarse = lattice.downsampled(2**level)
    return array_response(
        source,
        ArraySlice.parse(None, source.shape),
        kind,
        limit=image.nbytes,
        headers=axis_headers(coarse, level, window) | {"ETag": etag, "Vary": "Accept"},
        more=axis_json(coarse, level, window),
        field="max_size",
    )


def volume_response(
    arrays: BlobStore, identifier: str, kind: str, conditions: ReadPreconditions, wish: VolumeQuery, limit: int
) -> Response:
    """Return the response with a part of a volume, at the requested pyramid level or the finest within ``max_size``.

    Raises
    ------
    InvalidInput
        When the query is invalid for this volume, or the part is too large.
    """
    etag, stored = _stored(arrays, identifier, kind, wish.index)
    conditions.tag(etag, vary="Accept")
    whole = ArraySlice.parse(wish.slice, stored.lattice.shape)
    if wish.level is not None and wish.level > stored.levels:
        raise InvalidInput("level", wish.level, f"0 to {stored.levels}, which this volume has")
    level, selection = wish.level or 0, _coarser(whole, wish.level or 0)
    while level < stored.levels and wish.max_size is not None and max(selection.shape, default=0) > wish.max_size:
        level += 1
        selection = _coarser(whole, level)
    lattice = stored.lattice.downsampled(2**level)
    window = _window(wish, stored)
    source = converted(stored.level(level), wish.dtype, window)
    headers = axis_headers(lattice.slice(selection.index), level, window) | {"ETag": etag, "Vary": "Accept"}
    if kind == NPY:
        of = "" if wish.index is None else f"-{wish.index}"
        headers["Content-Disposition"] = f'attachment; filename="{identifier}{of}.npy"'
    more = axis_json(lattice.slice(selection.index), level, window)
    return array_response(source, selection, kind, limit=limit, headers=headers, more=more)


def _stored(arrays: BlobStore, identifier: str, kind: str, index: int | None) -> tuple[str, VolumeReader]:
    """Open a volume, or the projections of the newest live revision, and return its ETag and reader."""
    for name in (VOLUME, SERIES, PROJECTIONS, VOLUME):  # projections are removed when the volume is whole
        with suppress(FileNotFoundError, NotFound):
            path = arrays.open(result_name(identifier, name))
            return etag_of_file(path, kind=kind), stored_volume(path, etag_of_file(path), index)
    raise NotFound("volume of", identifier)


def _coarser(whole: ArraySlice, level: int) -> ArraySlice:
    return ArraySlice.point(in_coarser(whole.index, 2**level, "slice"))


def _slab(text: str | None, size: int) -> range:
    """Parse a slab in NumPy syntax to the range of its voxels along an axis of ``size`` voxels."""
    at = ArraySlice.parse(text, (size,), "slab").index[0]
    chosen = range(at, at + 1) if isinstance(at, int) else range(*at.indices(size))
    if not chosen:
        raise InvalidInput("slab", text, f"at least one of the {size} voxels along the axis")
    return chosen


def _window(wish: ProjectionQuery | VolumeQuery, stored: VolumeReader) -> Window | None:
    if wish.dtype == "uint8":
        return Window.parse(wish.window) if wish.window else Window(0.0, max(0.0, stored.max_value()) or 1.0)
    if wish.window is not None:
        raise InvalidInput("window", wish.window, "nothing without dtype=uint8, whose ends it states")
    return None
