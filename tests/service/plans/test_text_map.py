"""Tuning maps as text matrices: wavelengths in nm, a row for each y, a column for each x."""

import numpy as np
import pytest

from steradian import InvalidInput
from steradian.core.exceptions import DamagedFile
from steradian.plans import TuningMap

PITCH = 1e-4
MATRIX = 1550 + 0.01 * np.arange(15).reshape(3, 5)


def written(path, separator="\t", comma=False):
    text = "\n".join(separator.join(f"{value:.4f}" for value in row) for row in MATRIX)
    path.write_text("% wavelengths\n" + (text.replace(".", ",") if comma else text) + "\n")
    return path


@pytest.mark.parametrize(("separator", "comma"), [("\t", False), ("\t", True), (" ", False), (",", False), (";", True)])
def test_text_matrix_of_wavelengths_becomes_a_map_around_the_origin(tmp_path, separator, comma):
    source = written(tmp_path / "Opt R array_data_wavelength.txt", separator, comma)
    found = TuningMap.read(source, pitch=PITCH)
    x, y = np.meshgrid((np.arange(5) - 2) * PITCH, (np.arange(3) - 1) * PITCH)
    np.testing.assert_allclose(found.positions, np.column_stack([x.ravel(), y.ravel()]), atol=1e-15)
    np.testing.assert_allclose(found.wavelengths, MATRIX.ravel() / 1e9)


def test_points_of_a_text_matrix_that_were_not_tuned_are_left_out(tmp_path):
    (tmp_path / "a.txt").write_text("1550 0 1551\nnan 1552 1553\n")
    found = TuningMap.read(tmp_path / "a.txt", pitch=PITCH)
    assert found.wavelengths.tolist() == [1550e-9, 1551e-9, 1552e-9, 1553e-9]


def test_text_matrix_without_a_pitch_is_refused(tmp_path):
    with pytest.raises(InvalidInput, match="tuning_pitch is missing"):
        TuningMap.read(written(tmp_path / "a.txt"))


@pytest.mark.parametrize("text", ["0.3 0.4\n0.5 0.6\n", "1550 0.2\n", "0 0\n"])
def test_text_matrix_of_another_quantity_is_refused(tmp_path, text):
    (tmp_path / "R-map_pretuned_opt-parameters.txt").write_text(text)
    with pytest.raises(InvalidInput, match="reflectivity or sensitivity"):
        TuningMap.read(tmp_path / "R-map_pretuned_opt-parameters.txt", pitch=PITCH)


@pytest.mark.parametrize(("text", "words"), [("1550 1551\n1552\n", "line 2"), ("1550 1551\n1552 x\n", "line 2")])
def test_text_that_is_no_matrix_is_refused_by_its_line(tmp_path, text, words):
    (tmp_path / "a.txt").write_text(text)
    with pytest.raises(DamagedFile, match=words):
        TuningMap.read(tmp_path / "a.txt", pitch=PITCH)
