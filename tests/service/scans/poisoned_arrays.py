"""Arrays, tables, archives and MATLAB files that mean harm, and the words with which each is refused."""

import pickle
import sys
import zipfile
from pathlib import Path

import numpy as np
from scipy.io import savemat

sys.path.insert(0, str(Path(__file__).parent))
import foreign


def poisoned_zip(path, name, data, method=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", method) as archive:
        for other, value in {"dt": np.array(1e-8), "dx": np.array(1e-4), "c": np.array(1500.0)}.items():
            with archive.open(f"{other}.npy", "w") as member:
                np.save(member, value)
        with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
            member.write(data)
    return path


def header(shape, kind="<f4"):
    text = repr({"descr": kind, "fortran_order": False, "shape": shape}).encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


class Trap:
    """Writes a file when it is unpickled."""

    def __reduce__(self):
        return Path.touch, (Path("trapped"),)


def mat5(path, **variables):
    savemat(path, {"dt": foreign.DT, "c": foreign.SPEED, "positions": foreign.grid()} | variables, do_compression=True)
    return path


def function_handle(path):
    """A variable whose class is that of a function handle; nothing here can write a real one."""
    savemat(path, {"sensor_data": foreign.expected(foreign.grid())})
    data = bytearray(path.read_bytes())
    data[128 + 16] = 16  # the first byte of the flags of the first variable: its class
    path.write_bytes(data)
    return path


ARRAYS = [
    ("pickle.npy", header((1,), "|O") + pickle.dumps([Trap()]), "kind object"),
    ("truncated.npy", header((96, 128)) + b"123", "truncated"),
    ("longer.npy", header((2, 2)) + bytes(17), "more than"),
    ("absurd.npy", header((1 << 40, 1 << 40)), "shape"),
    ("negative.npy", header((-5, 16)), "shape"),
    ("flat.npy", header((16,)) + bytes(64), "points and time"),
    ("structured.npy", header((2,), [("a", "<f8")]) + bytes(16), "kind"),
    ("header.npy", b"\x93NUMPY\x01\x00\xff\xff" + b"(" * 65535, "not an .npy"),
    ("open.npy", b"\x93NUMPY\x01\x00\x40\x00" + b"{'descr': ('<f4'".ljust(63) + b"\n", "not an .npy"),
    ("words.csv", b"1,2,3\n4,five,6\n", r"line 2, field 2: 'five' is not a number"),
    ("ragged.csv", b"1,2,3\n4,5\n", "row 2"),
    ("empty.csv", b"# nothing\n", "no numbers"),
    ("late.csv", b"1,2,3\n" * 1000 + b"1,2,x\n", r"line 1001, field 3: 'x' is not a number"),
    ("pickle.bin", pickle.dumps([Trap()]), "neither"),
    ("none.h5", b"\x89HDF\r\n\x1a\n" + bytes(500), "HDF5"),
    ("none.zip", b"PK\x03\x04" + bytes(500), ".npz"),
]
"""Name, bytes and words."""
ARCHIVES = [
    (header((1 << 11, 64, 64)) + bytes(1 << 25), "200 times"),
    (header((1,), "|O") + pickle.dumps([Trap()]), "kind object"),
    (header((64, 4, 4)) + bytes(100), "end after"),
    (header((64, 4, 4)) + bytes(64 * 4 * 4 * 4 + 400), "end after"),
]
"""Bytes of the member ``p`` of an archive, and words: a zip bomb, a pickle, one that ends early, an endless one."""
MATLAB = [
    (lambda path: mat5(path, other=np.zeros((3, 3))), "has no variable 'sensor_data'; it holds dt, c, positions"),
    (lambda path: mat5(path, sensor_data=np.array([1, "a"], object)), "sensor_data is a cell"),
    (lambda path: mat5(path, sensor_data={"q": np.zeros((3, 3))}), r"the fields of sensor_data are sensor_data\.q"),
    (lambda path: mat5(path, sensor_data="words"), "sensor_data is a char"),
    (lambda path: mat5(path, sensor_data=np.zeros((96, 128), complex)), "no real numbers"),
    (lambda path: mat5(path, sensor_data=np.zeros((96, 65536))), "200 times"),
    (lambda path: mat5(path, sensor_data=np.zeros(0)), "has no variable 'sensor_data' with numbers in it"),
    (lambda path: mat5(path, sensor_data=np.full((96, 128), np.nan)), "finite"),
    (function_handle, "sensor_data is a function"),
]
"""What writes one, and words: cells, structures, functions, texts and bombs where numbers belong."""
