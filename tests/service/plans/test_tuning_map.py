"""A tuning map says what was measured, and how sure it is in between."""

import numpy as np
import pytest

import fabry_perot
from steradian import InvalidInput, grid_mask
from steradian.core.exceptions import DamagedFile, NotFound
from steradian.plans import TuningMap
from steradian.plans.files import write_json

RANDOM = np.random.default_rng(0)
PLACES = RANDOM.uniform(-6e-3, 6e-3, (400, 2))
ASKED = RANDOM.uniform(-5e-3, 5e-3, (300, 2))


def wedge(places):
    """Return a film of 0.4 nm a millimetre with a bend."""
    x, y = 1e3 * places.T
    return 1.55e-6 + 1e-9 * (0.3 * x - 0.2 * y + 0.02 * x * y)


def test_tuning_map_returns_measured_wavelength_at_measured_position():
    """To the last digit, and as sure as a sweep is."""
    known = TuningMap.create(positions=PLACES, wavelengths=wedge(PLACES), repeatability=2e-12)
    found, uncertainty = known.at(PLACES[::-1] + 0.4e-6)
    np.testing.assert_array_equal(found, known.wavelengths[::-1])
    assert (uncertainty == 2e-12).all()


def test_tuning_map_interpolation_error_matches_uncertainty():
    """The stated uncertainty is that of the error, within a factor of two."""
    found, uncertainty = TuningMap.create(positions=PLACES, wavelengths=wedge(PLACES)).at(ASKED)
    error = np.sqrt(((found - wedge(ASKED)) ** 2).mean())
    assert error < 15e-12
    assert 0.5 < np.sqrt((uncertainty**2).mean()) / error < 2


def test_a_film_that_scatters_is_known_nowhere_but_where_it_was_measured():
    """The uncertainty is then as large as the scatter, not as small as the map is dense."""
    noise = RANDOM.normal(0, 300e-12, len(PLACES))
    known = TuningMap.create(positions=PLACES, wavelengths=wedge(PLACES) + noise)
    uncertainty = known.at(ASKED)[1]
    assert 250e-12 < np.sqrt((uncertainty**2).mean()) < 600e-12
    fields = known.as_plan_fields(grid_mask(1e-2, 10, 1e-3))
    assert 250e-12 < fields["wavelength_uncertainty"] < 600e-12
    assert fields["wavelengths"].shape == (100,)


@pytest.mark.parametrize("count", [2, 3, 5])
def test_few_places_and_places_on_a_line_do_as_far_as_they_can(count):
    """Never beyond what they say by more than half their spread."""
    places = np.column_stack([np.linspace(-5e-3, 5e-3, count), np.zeros(count)])
    known = TuningMap.create(positions=places, wavelengths=wedge(places))
    found = known.at(ASKED)[0]
    spread = np.ptp(known.wavelengths)
    assert known.wavelengths.min() - 0.51 * spread <= found.min()
    assert found.max() <= known.wavelengths.max() + 0.51 * spread


def test_maps_are_read_as_the_driver_writes_them_from_tables_and_from_json(tmp_path):
    """The same map three times."""
    wavelengths = wedge(PLACES)
    level = np.ones(len(PLACES))
    fabry_perot.TuningMap(PLACES, wavelengths, level, level).save(tmp_path / "map.npz")
    table = np.column_stack([1e3 * PLACES, 1e9 * wavelengths])
    np.savetxt(tmp_path / "map.csv", table, delimiter=",", header="x_mm,y_mm,wavelength_nm", comments="", fmt="%.17g")
    write_json(TuningMap.create(positions=PLACES, wavelengths=wavelengths), tmp_path / "map.json")
    for name in ("map.npz", "map.csv", "map.json"):
        found = TuningMap.read(tmp_path / name)
        np.testing.assert_allclose(found.positions, PLACES, rtol=1e-14)
        np.testing.assert_allclose(found.wavelengths, wavelengths, rtol=1e-14)


def test_a_table_that_a_spreadsheet_saved_is_read(tmp_path):
    """Columns in any order, with a mark of the encoding before them, and lines that end in two characters."""
    (tmp_path / "map.csv").write_bytes("\ufeffwavelength_nm,x_mm,y_mm\r\n1550.5,1,-2\r\n".encode())
    found = TuningMap.read(tmp_path / "map.csv")
    np.testing.assert_allclose(found.positions, [[1e-3, -2e-3]])
    np.testing.assert_allclose(found.wavelengths, 1550.5e-9)


def test_invalid_tuning_map_is_refused_with_reason(tmp_path):
    """Missing, another file, another unit, one place for many points."""
    with pytest.raises(NotFound):
        TuningMap.read(tmp_path / "none.csv")
    (tmp_path / "other.csv").write_text("red,green\n1,2\n")
    (tmp_path / "other.npz").write_bytes(b"PK")
    for name in ("other.csv", "other.npz"):
        with pytest.raises(DamagedFile, match="x_mm, y_mm, wavelength_nm"):
            TuningMap.read(tmp_path / name)
    with pytest.raises(InvalidInput, match="wavelengths"):
        TuningMap.create(positions=PLACES, wavelengths=1e9 * wedge(PLACES))
    with pytest.raises(InvalidInput, match="one place"):
        TuningMap.create(positions=PLACES[:1], wavelengths=wedge(PLACES[:1])).at(ASKED)
