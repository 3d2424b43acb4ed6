"""Masks go into files and come back."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steradian import InvalidInput, custom_mask, equi_steradian_mask
from steradian.core.exceptions import DamagedFile, NotFound
from steradian.masks import equiangular_mask, read_mask, write_mask


@pytest.fixture
def mask():
    return equi_steradian_mask(1e-2, 3e-3, 100, offset=(1e-3, 0.0))


def test_mask_json_round_trip_preserves_id_and_offset(mask, tmp_path):
    """The same mask comes back."""
    write_mask(mask, tmp_path / "mask.json")
    again = read_mask(tmp_path / "mask.json")
    assert again.id == mask.id
    assert again.offset == mask.offset


@pytest.mark.parametrize("ending", ["csv", "npy"])
def test_tables_keep_points_and_weights(mask, tmp_path, ending):
    """Positions are the same to the last bit; weights to rounding."""
    write_mask(mask, tmp_path / f"mask.{ending}")
    again = read_mask(tmp_path / f"mask.{ending}", aperture=1e-2)
    np.testing.assert_array_equal(again.positions, mask.positions)
    np.testing.assert_allclose(again.weights, mask.weights, rtol=1e-12)


def test_a_line_survives_csv(tmp_path):
    """A line comes back as a line."""
    line = equiangular_mask(1e-2, 3e-3, 20)
    write_mask(line, tmp_path / "line.csv")
    again = read_mask(tmp_path / "line.csv", aperture=1e-2)
    assert again.is_line
    np.testing.assert_allclose(again.weights, line.weights, rtol=1e-12)


def test_a_table_in_millimetres_from_a_spreadsheet_is_understood(tmp_path):
    """The heading tells the unit; a byte-order mark and a missing weight do not matter."""
    (tmp_path / "lab.csv").write_text("\ufeffX_mm,Y_mm\n1,2\n-3,0.5\n", encoding="utf-8")
    mask = read_mask(tmp_path / "lab.csv", aperture=1e-2)
    np.testing.assert_allclose(mask.positions, [[1e-3, 2e-3], [-3e-3, 5e-4]])
    assert mask.weight_ratio == 1


@settings(max_examples=20, deadline=None)
@given(points=st.lists(st.tuples(st.floats(-5e-3, 5e-3), st.floats(-5e-3, 5e-3)), min_size=1, max_size=30))
def test_any_points_survive_json(points):
    """JSON holds any finite positions exactly."""
    mask = custom_mask(points, aperture=1e-2)
    assert type(mask).model_validate_json(mask.model_dump_json()).id == mask.id


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.json", b"{"),
        ("a.csv", b"x_m,y_m\n1,two\n"),
        ("a.csv", b"x_ft,y_ft\n1,2\n"),
        ("a.csv", b""),
        ("a.csv", b"\xff\xfe\x00"),
        ("a.npy", b"no array"),
    ],
)
def test_damaged_mask_file_is_refused_with_file_name(tmp_path, name, content):
    """What is not a mask is refused with the file's name."""
    (tmp_path / name).write_bytes(content)
    with pytest.raises(DamagedFile, match=name):
        read_mask(tmp_path / name, aperture=1e-2 if name != "a.json" else None)


def test_missing_figures_are_asked_for(mask, tmp_path):
    """Missing files, an unknown ending, a missing or contradicting aperture."""
    with pytest.raises(NotFound):
        read_mask(tmp_path / "none.json")
    with pytest.raises(InvalidInput, match=r"\.json, \.csv or \.npy"):
        write_mask(mask, tmp_path / "mask.xlsx")
    write_mask(mask, tmp_path / "mask.csv")
    with pytest.raises(InvalidInput, match="aperture"):
        read_mask(tmp_path / "mask.csv")
    write_mask(mask, tmp_path / "mask.json")
    with pytest.raises(InvalidInput, match="the file's own"):
        read_mask(tmp_path / "mask.json", aperture=2e-2)
