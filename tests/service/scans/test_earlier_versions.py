"""Scan files that earlier versions of the program made are opened, checked, exported and continued like new ones.

``data/version-2.h5.gz`` is a scan of 29 points on the simulator, stopped after 13 of them; it was made by the program
that wrote version 2.
"""

import gzip
from pathlib import Path

import h5py
import numpy as np
import pytest

from fabry_perot.simulator import launch
from steradian.scans.acquisition.run import resume_scan
from steradian.scans.acquisition.session_control import SessionOutcome
from steradian.scans.exporting import export_scan
from steradian.scans.file.verify import verify_scan_file
from steradian.scans.file.writer import ScanFileWriter
from steradian.scans.opening import open_recording

MADE = Path(__file__).parent / "data" / "version-2.h5.gz"
STORED = [1, 4, 5, 6, 7, 12, 13, 14, 15, 16, 21, 22, 23]
ENERGY = [0.9468, 0.9459, 1.0417, 0.989, 1.0109, 0.9763, 0.9577, 0.9948, 1.0092, 0.9854, 0.9815, 0.9864, 0.9876]


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "version-2.h5"
    path.write_bytes(gzip.decompress(MADE.read_bytes()))
    return path


def raw(path):
    """What the file holds, past all of our own readers."""
    with h5py.File(path) as file:
        return {name: data[:] for name, data in file["alines"].items()}


def test_it_opens(path):
    truth, recording = raw(path), open_recording(path)
    np.testing.assert_array_equal(recording.traces, truth["samples"][STORED])
    np.testing.assert_array_equal(recording.scale, truth["scale"][STORED])
    assert recording.traces.std() > 0
    assert (recording.planned, recording.time_zero) == (29, 0.0)


def test_it_is_checked_and_a_damaged_row_in_it_is_found(path):
    report = verify_scan_file(path)
    assert report.is_consistent
    assert np.flatnonzero(report.strength).tolist() == STORED
    with h5py.File(path, "r+") as file:
        file["alines/samples"][5, 100:] = 7
    assert verify_scan_file(path).damaged.tolist() == [5]
    assert len(open_recording(path).traces) == 12


def test_a_row_that_it_does_not_list_is_not_listed_by_the_check(path):
    """Its checksums cover the samples alone: nothing would prove the scale and the energy of such a row."""
    with h5py.File(path, "r+") as file:
        file["alines/status"][5] = 0
        file["alines/scale"][5] = 0.0
    report = verify_scan_file(path)
    assert not len(report.unlisted)
    assert len(open_recording(path).traces) == 12


def test_it_is_exported(path, tmp_path):
    truth = raw(path)
    export_scan(path, tmp_path / "a.hdf5")
    again = open_recording(tmp_path / "a.hdf5")
    pressure = truth["samples"][STORED] * truth["scale"][STORED, None]
    np.testing.assert_allclose(np.asarray(again.traces), pressure, rtol=1e-6)


def test_resume_of_version_2_file_keeps_stored_data_and_schema_version(path):
    """What it holds stays bit for bit; what is added it holds as its own version says."""
    before = raw(path)
    with launch(speed=20.0, noise_db=float("inf"), energy_jitter=0.05, ring=8) as simulator:
        summary = resume_scan(path, simulator.url)
    assert (summary.end, summary.stored) == (SessionOutcome.COMPLETE, 29)
    after = raw(path)
    for name, values in after.items():
        np.testing.assert_array_equal(values[STORED], before[name][STORED], err_msg=name)
    np.testing.assert_allclose(after["energy"][STORED], ENERGY, rtol=1e-6)
    assert after["energy"].all()
    with h5py.File(path) as file:
        assert file.attrs["schema_version"] == 2
    assert verify_scan_file(path).is_consistent
    assert len(open_recording(path).traces) == 29
    with ScanFileWriter(path) as store:
        assert not store.missing.any()
