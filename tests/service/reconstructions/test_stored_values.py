"""Parts of a dataset, read by their places in the file, are what numpy and h5py find there."""

import itertools

import h5py
import numpy as np
import pytest

from steradian.core.exceptions import DamagedFile
from steradian.reconstructions.volumes import lazy_array as stored_values
from steradian.reconstructions.volumes.grid import VoxelGrid, in_coarser
from steradian.reconstructions.volumes.lazy_array import ChunkedDataset

VALUES = np.random.default_rng(0).normal(size=(9, 10, 23)).astype(np.float32)
PARTS = [slice(0, 99, 1), slice(3, 8, 1), slice(1, 99, 4), slice(4, 4, 1), 0, 7]


@pytest.mark.parametrize("chunks", [None, (4, 5, 8), (9, 10, 23), (1, 1, 23), (3, 10, 7)])
def test_chunked_read_matches_numpy_indexing(tmp_path, chunks, monkeypatch):
    monkeypatch.setattr(stored_values, "CHUNK_BYTES", 2500)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        stored = ChunkedDataset(file.create_dataset("values", data=VALUES, chunks=chunks))
    for index in itertools.product(PARTS, repeat=3):
        expected = VALUES[index]
        found = stored.read(
            tuple(
                at if isinstance(at, int) else slice(*at.indices(n)) for at, n in zip(index, VALUES.shape, strict=True)
            )
        )
        np.testing.assert_array_equal(found, expected)
        if isinstance(index[0], slice) and expected.size:
            pieces = list(stored.iter_chunks(index))
            np.testing.assert_array_equal(np.concatenate(pieces), expected)


@pytest.mark.parametrize("another", [False, True])
def test_chunked_read_survives_file_deletion_or_replacement(tmp_path, monkeypatch, another):
    monkeypatch.setattr(stored_values, "CHUNK_BYTES", 2500)
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        stored = ChunkedDataset(file.create_dataset("values", data=VALUES))
    pieces = stored.iter_chunks(tuple(slice(0, size, 1) for size in VALUES.shape))
    found = [next(pieces)]
    path.unlink()
    if another:
        path.write_bytes(bytes(100_000))
    np.testing.assert_array_equal(np.concatenate([*found, *pieces]), VALUES)


def test_a_file_that_ends_too_early_or_is_compressed_is_damaged(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        stored = ChunkedDataset(file.create_dataset("values", data=VALUES))
        packed = file.create_dataset("packed", data=VALUES, compression="gzip")
        empty = file.create_dataset("empty", (4, 4, 4), "f4", chunks=(2, 2, 2))
        for dataset in (packed, empty):
            with pytest.raises(DamagedFile):
                ChunkedDataset(dataset)
    path = tmp_path / "a.h5"
    path.write_bytes(path.read_bytes()[: stored.places[0, 0, 0] + 100])
    with pytest.raises(DamagedFile, match="ends before"):
        stored.read((slice(0, 9, 1), 0, 0))


def test_a_coarser_lattice_lies_over_the_voxels_that_it_averages():
    fine = VoxelGrid(("x", "z"), (-2.0, 0.5), (1.0, 0.25), (5, 8))
    coarse = fine.downsampled(2)
    assert coarse == VoxelGrid(("x", "z"), (-1.5, 0.625), (2.0, 0.5), (3, 4))
    assert coarse.downsampled(2) == fine.downsampled(4)
    assert in_coarser((slice(3, 5, 1), 7), 2, "slice") == (slice(1, 3, 1), 3)
    assert fine.slice((3, slice(2, 8, 3))) == VoxelGrid(("z",), (1.0,), (0.75,), (2,))
