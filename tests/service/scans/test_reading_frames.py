"""Which frame of a scan is read where none is named, or one that there is not."""

import numpy as np
import pytest

import steradian
from steradian import InvalidInput, ScanPlan, grid_mask
from steradian.scans.file.read import read_scan
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from support.alines import Aline


def scan_of(folder, frames):
    plan, path = ScanPlan.create(mask=grid_mask(0.01, 4, 1e-3), samples=64, frames=frames), folder / f"{frames}.h5"
    create_scan_file(path, plan)
    with ScanFileWriter(path) as store:
        store.append(Aline(point, np.full(64, point // 16, np.int16)) for point in range(16 * frames))
    return path


def test_read_scan_without_a_frame_reads_the_only_one(tmp_path):
    path = scan_of(tmp_path, 1)
    np.testing.assert_array_equal(read_scan(path, None).traces, read_scan(path).traces)
    assert steradian.open(path).recording(None).planned == 16


@pytest.mark.parametrize("frame", [None, 2, -1, 1.0, "1", True])
def test_read_scan_of_several_frames_with_no_number_of_one_names_frame_and_range(tmp_path, frame):
    path = scan_of(tmp_path, 2)
    with pytest.raises(InvalidInput, match=f"frame is {frame}; allowed: a whole number, 0 to 1"):
        read_scan(path, frame)
    with pytest.raises(InvalidInput, match="frame is"):
        steradian.open(path).reconstruct(frame=frame)


def test_read_scan_with_a_frame_of_numpy_reads_it(tmp_path):
    assert (read_scan(scan_of(tmp_path, 2), np.int64(1)).traces == 1).all()
