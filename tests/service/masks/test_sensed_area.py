"""Weights are areas: of cells that darts find, within what each arrangement says that it senses."""

import json
from functools import cache

import h5py
import numpy as np
import pytest
from scipy.spatial import KDTree

from steradian import InvalidInput, ScanPlan, custom_mask, equi_steradian_mask, grid_mask
from steradian.imaging.geometry.polygons import contains
from steradian.masks import (
    Mask,
    PointOfInterest,
    ScannerGrid,
    combined_mask,
    equiangular_mask,
    hexagonal_mask,
    poisson_disc_mask,
    random_mask,
    read_mask,
    subset_mask,
    write_mask,
)
from steradian.scans.file.create import create_scan_file

X = 12e-3
DISC = np.pi * X**2 / 4
POINTS = [PointOfInterest(depth=2e-3, count=300, offset=(x, 0.0)) for x in (-3e-3, 3e-3)]
CELLS = {
    "equi-steradian": (lambda: equi_steradian_mask(X, 3.6e-3, 300), DISC),
    "on a scanner's grid": (
        lambda: equi_steradian_mask(X, 3.6e-3, 300, grid=ScannerGrid(count=240, interval=5e-5)),
        DISC,
    ),
    "small grid": (lambda: grid_mask(X, 20, 3e-4), (20 * 3e-4) ** 2),
    "random": (lambda: random_mask(X, 300), X**2),
    "poisson-disc": (lambda: poisson_disc_mask(X, 6e-4), X**2),
    "combined": (lambda: combined_mask(X, POINTS), X**2),
    "explicit": (lambda: custom_mask(random_mask(X, 300).positions, X), X**2),
    "rectangle": (lambda: custom_mask(np.argwhere(np.ones((16, 10))) * 5e-4 - [4e-3, 2.5e-3], X), 160 * 5e-4**2),
}
"""What makes a mask of each kind, and the area that it senses."""


@cache
def made(name):
    return CELLS[name][0]()


@pytest.mark.parametrize("name", CELLS)
def test_mask_weights_match_monte_carlo_cell_areas(name):
    """Of many random places within the outline, each point is nearest to the share that its weight says."""
    mask, (_, area) = made(name), CELLS[name]
    assert mask.sensed_area == pytest.approx(area, rel=0.025)  # explicit points: where the hull ends is a guess
    low, high = mask.outline.min(axis=0), mask.outline.max(axis=0)
    darts = low + np.random.default_rng(0).random((400_000, 2)) * (high - low)
    hits = np.bincount(KDTree(mask.positions).query(darts[contains(mask.outline, darts)])[1], minlength=mask.count)
    each = np.prod(high - low) / len(darts)
    assert np.abs(hits * each - mask.weights).max() < 5 * np.sqrt(hits.max()) * each


def test_a_hexagonal_lattice_has_cells_of_its_own_and_a_line_ends_at_its_ends():
    """Every lattice point has √3/2·d²; a line's cells go from midpoint to midpoint."""
    lattice = hexagonal_mask(X, 5e-4)
    np.testing.assert_allclose(lattice.weights, np.sqrt(3) / 2 * 5e-4**2, rtol=1e-12)
    line = equiangular_mask(X, 2e-3, 32)
    x = line.positions[:, 0]
    bounds = np.concatenate([[-X / 2], (x[1:] + x[:-1]) / 2, [X / 2]])
    np.testing.assert_allclose(line.weights, np.diff(bounds), rtol=1e-9)


def test_subset_mask_senses_only_its_own_area():
    """Every second point of a grid stands for four cells; a quarter of the field for a quarter."""
    grid = grid_mask(X, 20, 6e-4)
    thin = subset_mask(grid, [i for i in range(400) if i % 2 == 0 and i // 20 % 2 == 0])
    assert thin.sensed_area == pytest.approx(X * X, rel=0.06)  # the last row and column are left out
    assert np.median(thin.weights) == pytest.approx((2 * 6e-4) ** 2)
    corner = subset_mask(grid, [i for i in range(400) if i % 20 < 10 and i // 20 < 10])
    assert corner.sensed_area == pytest.approx(X * X / 4)


@pytest.mark.parametrize("apart", [5e-324, 2.8e-212, 1e-30, 1e-15])
def test_points_that_no_scanner_could_tell_apart_are_at_one_place(apart):
    """Together they stand for the whole aperture; as twins of others, for what those stand for alone."""
    square = apart * np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
    for close in (square[:2], square[:3], square):
        np.testing.assert_allclose(custom_mask(close, X).weights, X * X / len(close), rtol=1e-9)
    three = np.array([[-1e-3, 0], [1e-3, 0], [0, 1e-3]])
    twins = np.concatenate([three, three + np.array([0, apart])])
    np.testing.assert_allclose(custom_mask(twins, X).weights, np.tile(custom_mask(three, X).weights / 2, 2), rtol=1e-6)
    assert custom_mask(square + 1e-3 * np.eye(4, 2), X).sensed_area > 1e-8


@pytest.mark.parametrize("name", ["mask.json", "mask.csv", "mask.npy"])
def test_files_keep_the_sensed_area(tmp_path, name):
    """As JSON, CSV and npy a mask stands for the same area; JSON says it in words."""
    mask = made("equi-steradian")
    write_mask(mask, tmp_path / name)
    again = read_mask(tmp_path / name, X)
    assert again.sensed_area == pytest.approx(DISC, rel=1e-9)
    if name.endswith(".json"):
        assert json.loads((tmp_path / name).read_text())["sensed_area"] == pytest.approx(DISC)
        assert again.id == mask.id


def test_unitless_weights_are_scaled_and_areas_with_units_kept(tmp_path):
    """Weights without a unit share what the points sense; a column in mm² is taken at its word."""
    positions = made("small grid").positions
    assert custom_mask(positions, X, np.full(400, 7.0)).sensed_area == pytest.approx((20 * 3e-4) ** 2)
    rows = "\n".join(f"{1e3 * x},{1e3 * y},0.1" for x, y in positions)
    (tmp_path / "a.csv").write_text("x_mm,y_mm,weight_mm2\n" + rows)
    assert read_mask(tmp_path / "a.csv", X).sensed_area == pytest.approx(400 * 0.1e-6)
    (tmp_path / "b.csv").write_text("x_mm,y_mm,weight\n" + rows)
    assert read_mask(tmp_path / "b.csv", X).sensed_area == pytest.approx((20 * 3e-4) ** 2)


def test_a_scan_file_states_the_sensed_area(tmp_path):
    """With the corners of its outline."""
    mask = made("equi-steradian")
    create_scan_file(tmp_path / "scan.h5", ScanPlan.create(mask=mask), scan_id="s", scanner="A")
    with h5py.File(tmp_path / "scan.h5") as file:
        assert file["mask"].attrs["sensed_area_m2"] == pytest.approx(DISC)
        np.testing.assert_array_equal(file["mask/outline"], mask.outline)


def test_mask_without_outline_keeps_its_weights():
    """Weights that sum to the aperture, without an outline, are read as they are; impossible ones are refused."""
    old = {"aperture": X, "positions": [[0, 0], [1e-3, 0]], "weights": [X * X / 3, 2 * X * X / 3], "arrangement": {}}
    mask = Mask.model_validate_json(json.dumps(old))
    assert mask.outline is None
    assert mask.sensed_area == pytest.approx(X * X)
    with pytest.raises(InvalidInput, match="at most 4 apertures"):
        Mask.create(**old | {"weights": [1.0, 1.0]})
    for corners in ([[0, 0], [0, 1e-3], [1e-3, 0]], [[0, 0], [2e-3, 0], [1e-3, 1e-4], [0, 2e-3]], [[0, 0], [1e-3, 0]]):
        with pytest.raises(InvalidInput, match="outline"):
            Mask.create(**old | {"outline": corners})
