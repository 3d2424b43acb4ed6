"""A scan or volume file whose headers are damaged is named as such by all that read it, whatever HDF5 raises."""

import numpy as np
import pytest

from steradian.core.exceptions import DamagedFile
from steradian.imaging import Volume, VoxelAxes
from steradian.reconstructions.scan_plan_reader import read_stored_plan
from steradian.reconstructions.volumes.file import read_projection, read_volume, write_volume
from steradian.reconstructions.volumes.reader import VolumeReader
from steradian.scans.file.read import list_frames, read_scan
from steradian.scans.file.tail import IdleDetector, ScanTail
from steradian.scans.file.verify import verify_scan_file
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from steradian.scans.summary import count_alines
from support.damage import BITS, NAMED_TYPE, SCALAR, spoil


@pytest.fixture
def path(tmp_path, plan, alines):
    file = tmp_path / "scan.h5"
    create_scan_file(file, plan, scan_id="s1", simulated=True)
    with ScanFileWriter(file) as store:
        store.append(alines)
    return file


@pytest.mark.parametrize("bit", BITS)
@pytest.mark.parametrize("read", [verify_scan_file, read_stored_plan, list_frames, read_scan, ScanTail])
def test_read_scan_with_damaged_status_table_raises_damaged_file(path, read, bit):
    spoil(path, "alines/status", bit)
    with pytest.raises(DamagedFile, match=path.name):
        read(path)


@pytest.mark.parametrize("read", [verify_scan_file, read_scan, ScanFileWriter])
def test_read_scan_with_damaged_samples_raises_damaged_file(path, read):
    spoil(path, "alines/samples")
    with pytest.raises(DamagedFile, match=path.name):
        read(path)


@pytest.mark.parametrize("dataset", ["alines/status", "fired"])
def test_count_alines_of_damaged_dataset_returns_empty(path, dataset):
    assert count_alines(path)["stored"] == 53
    spoil(path, dataset)
    assert count_alines(path) == {}


def test_a_scan_that_is_followed_and_damaged_meanwhile_is_so(path):
    follower = ScanTail(path)
    spoil(path, "alines/crc32c")
    with pytest.raises(DamagedFile, match=path.name):
        follower.read_new()


@pytest.mark.parametrize("bit", BITS)
def test_idle_detector_with_damaged_status_table_raises_damaged_file(path, bit):
    is_over = IdleDetector(path, patience=1e3)
    assert is_over()
    spoil(path, "alines/status", bit)
    with pytest.raises(DamagedFile, match=path.name):
        is_over()


@pytest.fixture
def volume_file(tmp_path):
    path, axis = tmp_path / "volume.h5", np.arange(4) * 1e-4
    volume = Volume(np.ones((4, 4, 4), np.float32), VoxelAxes(axis, axis, axis), (1e-4,) * 3)
    write_volume(path, volume, parameters={}, provenance={})
    return path


@pytest.mark.parametrize("bit", BITS)
@pytest.mark.parametrize("read", [VolumeReader, read_volume])
def test_read_volume_with_damaged_values_raises_damaged_file(volume_file, read, bit):
    spoil(volume_file, "values", bit)
    with pytest.raises(DamagedFile, match=volume_file.name):
        read(volume_file)


@pytest.mark.parametrize("bit", [NAMED_TYPE, SCALAR])
def test_a_projection_that_is_none_is_damaged(volume_file, bit):
    spoil(volume_file, "mip_z", bit)
    with pytest.raises(DamagedFile, match=volume_file.name):
        read_projection(volume_file, "z").shape[1]
