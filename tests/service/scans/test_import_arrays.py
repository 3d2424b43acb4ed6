"""Arrays, tables and archives from strangers: no pickle is read, and no header is believed before it is checked."""

import pickle
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
import foreign
from poisoned_arrays import ARCHIVES, ARRAYS, Trap, header, poisoned_zip

from steradian.core.exceptions import DamagedFile, InvalidInput
from steradian.scans.importing import import_scan


@pytest.mark.parametrize(("name", "data", "words"), ARRAYS)
def test_a_poisoned_array_is_refused_and_never_unpickled(tmp_path, monkeypatch, name, data, words):
    """Pickles, lying headers and broken tables end in one clear error."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_bytes(data)
    about = foreign.describe(tmp_path, sampling_interval=1e-8, sound_speed=1500.0, grid={"interval": [1e-4]})
    with pytest.raises((DamagedFile, InvalidInput), match=words):
        import_scan(tmp_path / name, tmp_path / "scan.h5", description=about)
    assert not (tmp_path / "trapped").exists()
    assert not (tmp_path / "scan.h5").exists()


def test_a_positions_file_that_lies_about_its_size_is_refused_unread(tmp_path):
    """Neither 8 EB nor a pickle is taken from a file that a description names."""
    source, _ = foreign.npy_time_first(tmp_path)
    about = {"sampling_interval": 1e-8, "sound_speed": 1500.0, "axes": "time, point", "positions": "where.npy"}
    for data in (header((1 << 60, 2)), header((1 << 20, 2)), header((96,), "|O") + pickle.dumps([Trap()])):
        (tmp_path / "where.npy").write_bytes(data)
        with pytest.raises(DamagedFile, match=r"where\.npy"):
            import_scan(source, tmp_path / "scan.h5", description=foreign.describe(tmp_path, **about))


def test_poisoned_archives_are_refused(tmp_path):
    for data, words in ARCHIVES:
        source = poisoned_zip(tmp_path / "a.npz", "p", data)
        with pytest.raises(DamagedFile, match=words):
            import_scan(source, tmp_path / "scan.h5")
        assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]
