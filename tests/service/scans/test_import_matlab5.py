"""MATLAB files before version 7.3 from strangers: numbers that the import has a use for, and nothing else."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
import foreign
from poisoned_arrays import MATLAB, mat5

from steradian.core.exceptions import DamagedFile, InvalidInput
from steradian.scans.importing import import_scan


@pytest.mark.parametrize(("write", "words"), MATLAB)
def test_a_matlab_file_of_more_than_numbers_is_refused(tmp_path, write, words):
    """Cells, structures, functions, texts and bombs where numbers belong: named; what to do instead is said."""
    source = write(tmp_path / "a.mat")
    with pytest.raises((DamagedFile, InvalidInput), match=words):
        import_scan(source, tmp_path / "new" / "scan.h5")
    assert not list((tmp_path / "new").iterdir())


def test_matlab_import_ignores_unrelated_variables(tmp_path):
    """Cells, structures and texts of the user's own are not read."""
    notes = {"notes": np.array([1, "a"], object), "about": {"when": 3}, "name": "film"}
    source = mat5(tmp_path / "a.mat", sensor_data=foreign.expected(foreign.grid()), **notes)
    assert import_scan(source, tmp_path / "scan.h5").points == len(foreign.grid())


def test_matlab_file_with_mismatched_version_number_is_refused_as_damaged(tmp_path):
    """Its first words are those of version 5, its version number is that of 7.3."""
    source = mat5(tmp_path / "a.mat", sensor_data=foreign.expected(foreign.grid()))
    data = bytearray(source.read_bytes())
    data[124:126] = b"\x00\x02"
    source.write_bytes(data)
    with pytest.raises(DamagedFile, match=r"a\.mat cannot be read as a MATLAB file"):
        import_scan(source, tmp_path / "scan.h5")
