"""Imports in a process of their own: a file that ends or holds up its reader ends in one clear error."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
import foreign
import import_fuzz

from steradian.core.exceptions import Cancelled, Conflict, DamagedFile, InvalidInput, NotFound
from steradian.scans.importing import import_scan
from steradian.scans.importing.sandbox import import_in_sandbox


def _endless(path):
    """Give the object of a global heap neither number nor size: the HDF5 library looks for the next one for ever."""
    data = bytearray(path.read_bytes())
    at = data.index(b"GCOL") + 16
    data[at : at + 2], data[at + 8 : at + 16] = bytes(2), bytes(8)
    path.write_bytes(data)


@pytest.mark.long
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits of a process are Linux's")
def test_a_file_that_sends_its_reader_in_circles_is_refused(tmp_path):
    """The format's name cannot be read in any time; the message says what became of the reader."""
    source, _ = foreign.own_scan(tmp_path)
    _endless(source)
    with pytest.raises(DamagedFile, match=r"own\.h5 cannot be read: its reader ended at its limit of time"):
        import_in_sandbox(source, tmp_path / "new" / "scan.h5", seconds=1)
    assert not (tmp_path / "new").exists() or not list((tmp_path / "new").iterdir())


@pytest.mark.long
def test_the_result_is_that_of_an_import_without_a_guard(tmp_path):
    """Same file, same summary, progress on the way."""
    source, description = foreign.npy_time_first(tmp_path)
    seen = []
    made = import_in_sandbox(
        source, tmp_path / "a.h5", description=description, progress=lambda *told: seen.append(told)
    )
    plain = import_scan(source, tmp_path / "b.h5", description=description)
    assert (made.format, made.points, made.samples) == (plain.format, plain.points, plain.samples)
    assert seen == [("A-lines", 96, 96)]
    with h5py.File(tmp_path / "a.h5") as one, h5py.File(tmp_path / "b.h5") as other:
        np.testing.assert_array_equal(one["alines/samples"], other["alines/samples"])


def test_sandboxed_import_preserves_error_types_fields_and_messages(tmp_path):
    """Kinds, fields and words of an error are those of the import."""
    source, _ = foreign.npy_time_first(tmp_path)
    with pytest.raises(InvalidInput, match="which the file does not state") as refusal:
        import_in_sandbox(
            source, tmp_path / "scan.h5", description=foreign.describe(tmp_path, grid={"interval": [1e-4]})
        )
    assert refusal.value.field == "sampling_interval"
    with pytest.raises(NotFound):
        import_in_sandbox(tmp_path / "none.npy", tmp_path / "scan.h5")
    (tmp_path / "scan.h5").write_bytes(b"")
    with pytest.raises(Conflict, match="exists"):
        import_in_sandbox(source, tmp_path / "scan.h5")


@pytest.mark.long
def test_modules_beside_a_file_are_not_run(tmp_path, monkeypatch):
    """Importing inside a downloaded folder runs no program of it, whatever module that is named after."""
    source, description = foreign.npy_time_first(tmp_path)
    for name in ("h5py", "json", "steradian"):
        (tmp_path / f"{name}.py").write_text("open('was-run', 'w')\n")
    monkeypatch.chdir(tmp_path)
    assert import_in_sandbox(source, tmp_path / "scan.h5", description=description).points == 96
    assert not (tmp_path / "was-run").exists()


@pytest.mark.long
def test_a_stopped_import_leaves_nothing(tmp_path):
    """Cancelled at the first report, the process is ended and what it began is removed."""
    source, description = foreign.npy_time_first(tmp_path)
    with pytest.raises(Cancelled):
        import_in_sandbox(source, tmp_path / "new" / "scan.h5", description=description, cancelled=lambda: True)
    assert list((tmp_path / "new").iterdir()) == []


@pytest.mark.long
def test_an_import_that_is_stopped_when_its_file_is_whole_leaves_nothing_either(tmp_path):
    """The process may be done before somebody who stops it is heard."""
    source, description = foreign.npy_time_first(tmp_path)

    def when_it_is_whole():
        end = time.monotonic() + 60
        while not any(path.is_file() for path in tmp_path.glob("new/**/scan.h5")):
            assert time.monotonic() < end
            time.sleep(0.01)
        return True

    with pytest.raises(Cancelled):
        import_in_sandbox(source, tmp_path / "new" / "scan.h5", description=description, cancelled=when_it_is_whole)
    assert list((tmp_path / "new").iterdir()) == []


COUNT = int(os.environ.get("STERADIAN_FUZZ_FILES", "60"))


@pytest.mark.long
@pytest.mark.timeout(300 + 8 * COUNT)
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits of a process are Linux's")
def test_mutated_files_are_imported_or_refused():
    """No file ends in another exception, in much memory or in another file's bytes, and none passes the guard alive.

    ``STERADIAN_FUZZ_FILES=20000`` makes it the long run.
    """
    command = [sys.executable, str(Path(import_fuzz.__file__)), str(COUNT), "--seed", "2"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    told = [json.loads(line) for line in done.stdout.splitlines()]
    assert [kind for line in told for kind in line] == list(import_fuzz.FORMATS)
    for ends in (ends for line in told for ends in line.values()):
        assert ends["refused"] + ends["imported"] == COUNT
        assert ends["refused"] > COUNT / 4
