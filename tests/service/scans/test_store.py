"""A scan file is valid at every moment and holds what was acknowledged."""

import fcntl
import os
import shutil
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import h5py
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from faulty_disk import FULL, FaultyDisk

from steradian.core.exceptions import Conflict, DamagedFile, InvalidInput, NotFound
from steradian.scans.exporting import export_scan
from steradian.scans.file import writer as store
from steradian.scans.file.locking import lock
from steradian.scans.file.tail import ScanTail
from steradian.scans.file.verify import verify_scan_file
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from steradian.scans.importing import import_scan
from steradian.scans.opening import open_recording


@pytest.fixture
def path(tmp_path, plan):
    file = tmp_path / "scan.h5"
    create_scan_file(file, plan, scan_id="s1", scanner="SIM-1", simulated=True)
    return file


def test_a_complete_scan_comes_back_bit_exact_in_mask_order(path, plan, alines):
    """Row m of a recording belongs to position m of the mask, whatever the order of the visit."""
    with ScanFileWriter(path) as store:
        store.append(alines)
    recording = open_recording(path)
    np.testing.assert_array_equal(recording.traces[plan.visit], [aline.samples for aline in alines])
    np.testing.assert_array_equal(recording.positions, plan.mask.positions)
    np.testing.assert_allclose(recording.weights, plan.mask.weights)
    assert recording.sampling_interval == plan.sampling_interval
    assert recording.provenance["plan_id"] == plan.id
    assert recording.provenance["mask_id"] == plan.mask.id
    assert recording.provenance["simulated"] == "True"


def test_a_partial_scan_has_its_points_and_rescaled_weights(path, plan, alines):
    """What is missing is left out; the weights of the rest sum to the sensed area again."""
    with ScanFileWriter(path) as store:
        store.append(alines[:20])
    recording = open_recording(path)
    assert len(recording.traces) == 20
    assert recording.planned == plan.mask.count
    np.testing.assert_array_equal(recording.positions, plan.mask.positions[np.sort(plan.visit[:20])])
    assert recording.weights.sum() == pytest.approx(plan.mask.sensed_area)


def test_the_file_is_readable_by_plain_hdf5_while_it_is_written(path, alines):
    """Another program sees the appended A-lines of a running scan at once."""
    with ScanFileWriter(path) as store:
        store.append(alines[:7])
        with h5py.File(path, "r") as file:
            assert int(np.sum(file["alines/status"][:])) == 7
            assert file["alines/samples"].chunks is not None
            assert file["mask/positions"].attrs["units"] == "m"


def test_a_copy_taken_between_any_two_writes_is_valid(path, alines, tmp_path):
    """A power cut at any moment leaves a readable file with every acknowledged A-line."""
    copy = tmp_path / "copy.h5"
    with ScanFileWriter(path) as store:
        overwrite = store._overwrite
        acknowledged = 0

        def overwrite_and_check(offset, data):
            overwrite(offset, data)
            if acknowledged:
                shutil.copy(path, copy)
                assert len(open_recording(copy).traces) >= acknowledged

        store._overwrite = overwrite_and_check
        for first in range(0, 20, 4):
            store.append(alines[first : first + 4])
            acknowledged += 4


def test_a_half_written_row_is_left_out(path, plan, alines):
    """A row that does not match its checksum, as a power cut may leave it, is not passed off as data."""
    with ScanFileWriter(path) as store:
        store.append(alines)
    place = int(plan.visit[5])
    with h5py.File(path, "r+") as file:
        row = file["alines/samples"][place]
        row[100:] = 0
        file["alines/samples"][place] = row
    assert len(open_recording(path).traces) == plan.mask.count - 1


COLUMNS = "scale energy wavelength_m fire_time_s quality shot averages time_zero_s dc_v gain_db".split()


@pytest.mark.parametrize("column", COLUMNS)
def test_a_row_with_a_wrong_column_is_not_passed_off_as_data(path, plan, alines, column, tmp_path):
    """… to a reconstruction, a live view, an export, an import or a continued scan: it is found and measured again."""
    with ScanFileWriter(path) as store:
        store.append(alines)
    with h5py.File(path, "r+") as file:
        file["alines"][column][5] += {"wavelength_m": 1e-9, "time_zero_s": 1e-9}.get(column, 1)
    others = np.delete(np.arange(plan.mask.count), 5)
    np.testing.assert_array_equal(open_recording(path).positions, plan.mask.positions[others])
    assert ScanTail(path).read_new().points.tolist() == others.tolist()
    exported = open_recording(export_scan(path, tmp_path / "out.hdf5"))
    assert len(exported.positions) == len(others)
    with pytest.raises(DamagedFile, match="A-line 5"):
        import_scan(path, tmp_path / "copy.h5")
    assert verify_scan_file(path).damaged.tolist() == [5]
    with ScanFileWriter(path) as store:
        assert np.flatnonzero(store.missing).tolist() == [5]


def test_verify_lists_statusless_row_only_if_its_columns_are_intact(path, alines):
    with ScanFileWriter(path) as store:
        store.append(alines)
    with h5py.File(path, "r+") as file:
        file["alines/status"][4:7] = 0
        file["alines/energy"][5] = 0.0
    report = verify_scan_file(path)
    assert (report.unlisted.tolist(), report.damaged.tolist()) == ([4, 6], [])
    with ScanFileWriter(path) as store:
        assert np.flatnonzero(store.missing).tolist() == [5]


def test_kill_9_loses_no_acknowledged_aline(path, plan, tmp_path):
    """A writer killed in the middle leaves every A-line that it said was durable."""
    script = textwrap.dedent(f"""
        import sys, numpy as np
        sys.path.insert(0, {str(Path(__file__).parents[2])!r})
        from support.alines import Aline
        from pathlib import Path
        from steradian.scans.file.writer import ScanFileWriter
        store = ScanFileWriter(Path({str(path)!r}))
        for point in range(store.count):
            store.append([Aline(point, np.full(store.samples, point, np.int16))])
            print(point, flush=True)
    """)
    writer = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    acknowledged = [int(next(writer.stdout)) for _ in range(25)]
    writer.send_signal(signal.SIGKILL)
    acknowledged += [int(line) for line in writer.stdout if line.endswith("\n")]
    writer.wait()
    writer.stdout.close()
    with h5py.File(path, "r") as file:
        samples, status = file["alines/samples"][:], file["alines/status"][:]
    for point in acknowledged:
        assert status[plan.visit[point]] == 1
        assert (samples[plan.visit[point]] == point).all()


def test_an_existing_file_is_never_overwritten(path, plan):
    """Creating a scan where a file exists is refused and leaves the file alone."""
    before = path.read_bytes()
    with pytest.raises(Conflict, match="exists"):
        create_scan_file(path, plan)
    assert path.read_bytes() == before


@pytest.mark.parametrize("size", [0, 100, 5000])
def test_a_truncated_file_is_named(path, alines, size):
    """A truncated file is a clear error with its name."""
    with ScanFileWriter(path) as store:
        store.append(alines)
    os.truncate(path, size)
    with pytest.raises(DamagedFile, match=r"scan\.h5"):
        open_recording(path)


def test_unknown_and_foreign_files_are_named(tmp_path):
    """A missing file, another HDF5 file and plain text are told apart."""
    with pytest.raises(NotFound, match=r"none\.h5"):
        open_recording(tmp_path / "none.h5")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["a"] = 1
    with pytest.raises(DamagedFile, match="format is None"):
        open_recording(tmp_path / "other.h5")
    (tmp_path / "text").write_text("hello")
    with pytest.raises(DamagedFile, match="neither"):
        open_recording(tmp_path / "text")


def test_an_empty_scan_cannot_be_reconstructed(path):
    """A scan without any A-line says so."""
    with pytest.raises(DamagedFile, match="no A-line"):
        open_recording(path)


def test_alines_of_another_plan_are_refused(path, alines):
    """An A-line of the wrong length or an unknown point is not stored."""
    with ScanFileWriter(path) as store:
        wrong = type(alines[0])(0, np.zeros(5, np.int16))
        with pytest.raises(InvalidInput, match="samples"):
            store.append([wrong])
        with pytest.raises(InvalidInput, match="point"):
            store.append([type(alines[0])(10**6, alines[0].samples)])
        assert store.stored == 0


def test_aline_with_failed_write_stays_missing_when_neighbours_are_stored(path, plan, alines, monkeypatch):
    """A batch writes the columns of the rows between its own with them, and these must not claim what is not there."""
    by_row = [alines[point] for point in np.argsort(plan.visit)]
    faults = iter([FULL])
    with ScanFileWriter(path) as store, FaultyDisk(path, lambda: next(faults, None)).mounted(monkeypatch):
        with pytest.raises(OSError, match="No space left"):
            store.append([by_row[7]])
        store.append([by_row[6], by_row[8]])
        assert store.missing[7]
    with h5py.File(path, "r") as file:
        assert file["alines/status"][6:9].tolist() == [1, 0, 1]
        assert file["alines/scale"][6:9].tolist() == [0.5, 0.0, 0.5]
    with ScanFileWriter(path) as store:
        store.append([by_row[7]])
        assert store.stored == 3


def test_a_file_has_one_writer_and_any_readers(path, alines):
    """A second session is refused while the first writes; readers are not, and a dead writer holds nothing."""
    with ScanFileWriter(path) as store:
        store.append(alines[:7])
        with pytest.raises(Conflict, match="another process"):
            ScanFileWriter(path)
        assert len(open_recording(path).traces) == 7
        store.append(alines[7:9])
        with pytest.raises(Conflict, match="another process"):
            ScanFileWriter(path)
    with ScanFileWriter(path) as store:
        assert store.stored == 9


def test_where_both_kinds_of_locks_are_one_a_running_scan_is_written_and_followed(path, alines, monkeypatch, tmp_path):
    """On NFS the writer's lock is one for the HDF5 library, too; here the writer holds both kinds."""

    def lock_like_nfs(handle, path):
        lock(handle, path)
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)

    monkeypatch.setattr(store, "lock", lock_like_nfs)
    with ScanFileWriter(path) as writer:
        follower = ScanTail(path)
        writer.append(alines[:7])
        with pytest.raises(OSError, match="unable to lock file"):
            h5py.File(path, "r")
        with pytest.raises(Conflict, match="another process"):
            ScanFileWriter(path)
        assert len(follower.read_new().points) == len(open_recording(path).traces) == 7
        writer.append(alines[7:])
        assert len(follower.read_new().points) == len(alines) - 7
        export_scan(path, tmp_path / "out.hdf5")
        assert verify_scan_file(path).is_consistent
    assert h5py.File(path, "r").close() is None
