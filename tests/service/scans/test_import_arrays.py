"""Arrays, tables and archives from strangers: no pickle is read, and no header is believed before it is checked."""

import pickle
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
import foreign

from steradian.errors import DamagedFile, InvalidInput
from steradian.scans.importing import import_scan


def _poisoned_zip(path, name, data, method=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", method) as archive:
        for other, value in {"dt": np.array(1e-8), "dx": np.array(1e-4), "c": np.array(1500.0)}.items():
            with archive.open(f"{other}.npy", "w") as member:
                np.save(member, value)
        with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
            member.write(data)
    return path


def _header(shape, kind="<f4"):
    text = repr({"descr": kind, "fortran_order": False, "shape": shape}).encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


class Trap:
    """Writes a file when it is unpickled."""

    def __reduce__(self):
        return Path.touch, (Path("trapped"),)


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("pickle.npy", _header((1,), "|O") + pickle.dumps([Trap()]), "kind object"),
        ("truncated.npy", _header((96, 128)) + b"123", "truncated"),
        ("longer.npy", _header((2, 2)) + bytes(17), "more than"),
        ("absurd.npy", _header((1 << 40, 1 << 40)), "shape"),
        ("negative.npy", _header((-5, 16)), "shape"),
        ("flat.npy", _header((16,)) + bytes(64), "points and time"),
        ("structured.npy", _header((2,), [("a", "<f8")]) + bytes(16), "kind"),
        ("header.npy", b"\x93NUMPY\x01\x00\xff\xff" + b"(" * 65535, "no .npy"),
        ("open.npy", b"\x93NUMPY\x01\x00\x40\x00" + b"{'descr': ('<f4'".ljust(63) + b"\n", "no .npy"),
        ("words.csv", b"1,2,3\n4,five,6\n", "neither"),
        ("ragged.csv", b"1,2,3\n4,5\n", "row 2"),
        ("empty.csv", b"# nothing\n", "no numbers"),
        ("late.csv", b"1,2,3\n" * 1000 + b"1,2,x\n", "not a table of numbers"),
        ("pickle.bin", pickle.dumps([Trap()]), "neither"),
        ("none.h5", b"\x89HDF\r\n\x1a\n" + bytes(500), "HDF5"),
        ("none.zip", b"PK\x03\x04" + bytes(500), ".npz"),
    ],
)
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
    for data in (_header((1 << 60, 2)), _header((1 << 20, 2)), _header((96,), "|O") + pickle.dumps([Trap()])):
        (tmp_path / "where.npy").write_bytes(data)
        with pytest.raises(DamagedFile, match=r"where\.npy"):
            import_scan(source, tmp_path / "scan.h5", description=foreign.describe(tmp_path, **about))


def test_poisoned_archives_are_refused(tmp_path):
    """A zip bomb, a pickle in a zip, a member that ends early and an endless one."""
    for data, words in [
        (_header((1 << 11, 64, 64)) + bytes(1 << 25), "200 times"),
        (_header((1,), "|O") + pickle.dumps([Trap()]), "kind object"),
        (_header((64, 4, 4)) + bytes(100), "end after"),
        (_header((64, 4, 4)) + bytes(64 * 4 * 4 * 4 + 400), "end after"),
    ]:
        source = _poisoned_zip(tmp_path / "a.npz", "p", data)
        with pytest.raises(DamagedFile, match=words):
            import_scan(source, tmp_path / "scan.h5")
        assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]
