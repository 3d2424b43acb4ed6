"""A-lines as text, as people and their programs write them: separators, decimal commas, headings, gaps."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
import foreign

from steradian.core.exceptions import DamagedFile
from steradian.scans.importing import import_scan
from steradian.scans.opening import open_recording

LINES = np.tile([[0.5, -1.25e-3, 0, 17], [2, 0.04, -3e5, 0.125], [0, 1, 2, 3]], 4)
ABOUT = {"sampling_interval": 2e-8, "sound_speed": 1500.0, "grid": {"interval": [1e-4]}}


def imported(folder, text, name="a.csv"):
    (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    made = import_scan(folder / name, folder / "scan.h5", description=foreign.describe(folder, **ABOUT))
    return open_recording(made.path).traces, made.notes


def table(separator, *, comma=False, end="\n", form="{:.6g}"):
    rows = [separator.join(form.format(value) for value in row) for row in LINES]
    text = end.join(rows) + end
    return text.replace(".", ",") if comma else text


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("form", ["{:.6g}", "{:.5f}", "{:+.3E}"])
@pytest.mark.parametrize("separator", [",", ";", "\t", " ", ", ", "; ", "   "])
def test_import_of_text_table_with_decimal_points_accepts_any_separator(tmp_path, separator, form, end):
    traces, notes = imported(tmp_path, table(separator, form=form, end=end))
    np.testing.assert_allclose(traces, np.array([[float(form.format(v)) for v in row] for row in LINES]), rtol=1e-6)
    assert notes == ()


@pytest.mark.parametrize("form", ["{:.6g}", "{:.5f}", "{:+.3E}"])
@pytest.mark.parametrize("separator", [";", "\t", " ", "; ", "   "])
def test_import_of_text_table_with_decimal_commas_is_read_with_note(tmp_path, separator, form):
    traces, notes = imported(tmp_path, table(separator, comma=True, form=form))
    np.testing.assert_allclose(traces, np.array([[float(form.format(v)) for v in row] for row in LINES]), rtol=1e-6)
    assert "decimal commas" in notes[0]


def test_positions_with_decimal_commas_are_read(tmp_path):
    np.save(tmp_path / "a.npy", LINES)
    (tmp_path / "where.csv").write_text("x (mm);y (mm)\n0,5;1,5\n0,5;2,5\n1,5;0,5\n")
    about = foreign.describe(tmp_path, **ABOUT | {"grid": None, "positions": "where.csv", "lengths": "mm"})
    recording = open_recording(import_scan(tmp_path / "a.npy", tmp_path / "scan.h5", description=about).path)
    np.testing.assert_allclose(np.ptp(recording.positions, axis=0), [1e-3, 2e-3])


@pytest.mark.parametrize(
    "start", ["t0,t1,t2\n", "# a comment\n", "% MATLAB's\n", "\ufeff", "\n\n", '"a","b","c","d"\n']
)
def test_text_table_with_something_before_its_numbers_is_read(tmp_path, start):
    traces, notes = imported(tmp_path, start + table(","))
    assert traces.shape == (3, 16)
    assert ("heading" in "".join(notes)) == ("t0" in start or '"' in start)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1,2,3\n1,,3\n", "line 2, field 2 is empty"),
        ("1;;3\n1;;3\n", "line 1, field 2 is empty"),
        ("1\t\t3\n", "line 1, field 2 is empty"),
        (",1,2\n", "line 1, field 1 is empty"),
        ("1,2\nnan,3\n", "line 2, field 1: 'nan' is not finite"),
        ("1 2\n3 1e999\n", "line 2, field 2: '1e999' is not finite"),
        ("a b\nc d\n1 2\n", "line 2, field 1: 'c' is not a number"),
        ("1,2\n'3',4\n", "line 2, field 1"),
        ("1.234,5;6,0\n", "line 1, field 1: '1.234,5' has commas"),
        ("1,2,3;4\n", "line 1, field 1: '1,2,3' has commas"),
        ("0,05,1,25\n", "line 1, field 2: '05' looks like the end of a decimal comma"),
        ("1,2,3\n4,5\n", "row 2 has 2 numbers"),
        ("1,2\n".encode("utf-16"), "UTF-16"),
    ],
)
def test_text_table_that_is_none_is_refused_by_line_and_field(tmp_path, text, words):
    with pytest.raises(DamagedFile, match=words):
        imported(tmp_path, text)
    assert not (tmp_path / "scan.h5").exists()
