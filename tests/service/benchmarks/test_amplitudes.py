"""One object has one amplitude, through whatever arrangement it was sensed; and README says what it prints."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fabry_perot.simulator.phantoms import Balls
from steradian.scans.importing.geometry import fit_sensor_plane
from steradian_benchmarks import iterative_amplitudes
from steradian_benchmarks.amplitudes import BEGIN, END, amplitudes, table, write_page

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def rows():
    return amplitudes(count=900)


@pytest.mark.long
def test_amplitudes_match_dense_grid_within_5_percent(rows):
    """Within 5 % for six arrangements and an imported rectangle, a ball and a vessel tree."""
    assert len(rows) == 7
    for row in rows:
        for what in ("ball", "tree"):
            assert row[what] == pytest.approx(row[f"{what}_dense"], rel=0.05), (row["mask"], what)


def test_a_ball_has_the_share_of_the_half_space_that_is_seen(rows):
    """Over a disc of 6 mm, 3.6 mm away, 1 − z/√(z² + R²) of its amplitude."""
    disc = rows[0]
    assert disc["sensed_mm2"] == pytest.approx(113.1, abs=0.1)
    assert disc["ball"] == pytest.approx(1 - 3.6 / (3.6**2 + 6**2) ** 0.5, rel=0.02)


def test_the_page_takes_the_table_between_its_marks(rows, tmp_path):
    """The rest of the page stays; writing it again changes nothing."""
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    write_page(page, rows)
    first = page.read_text()
    write_page(page, rows)
    assert page.read_text() == first
    assert first == f"before\n{BEGIN}\n{table(rows)}\n{END}\nafter\n"


@pytest.mark.long
def test_readmes_first_example_shows_the_amplitude_beside_its_truth():
    """Run word for word."""
    code = re.search(r"## A first reconstruction\n\n```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)
    done = subprocess.run([sys.executable, "-c", code[1]], capture_output=True, text=True, check=True)
    found = re.search(r"amplitude (\S+), true (\S+):", done.stdout)
    assert float(found[1]) == pytest.approx(float(found[2]), rel=0.05)
    assert "(226, 226, 1024) brightest at depth 0.0036" in done.stdout


def test_imported_rectangular_field_has_exact_sensed_area():
    """A field of 16 × 10 mm, every 200 µm, in the square aperture that an import finds for it."""
    field = np.argwhere(np.ones((80, 50))) * 2e-4
    sensors = fit_sensor_plane(field)
    assert sensors.aperture == pytest.approx(16e-3)
    mask = sensors.mask("npy")
    assert mask.sensed_area == pytest.approx(160e-6)
    np.testing.assert_allclose(mask.weights, 4e-8)


def test_visible_share_of_tubes_below_a_square_is_that_of_the_angle_under_which_they_see_it():
    """A tube parallel to the film by the angle of the square, an upright one none, one at the edge by one side's."""
    depth, side = 3e-3, 12e-3
    along = 1e-4 * np.arange(-3, 4)

    def share(centres):
        few = len(centres)
        return iterative_amplitudes.visible_share(Balls(centres, np.full(few, 1e-4), np.ones(few)), side)

    level = np.stack([along, 0 * along, np.full(7, depth)], axis=1)
    np.testing.assert_allclose(share(level), 2 * np.arctan(side / 2 / depth) / np.pi, atol=1 / 180)
    steep = np.stack([0 * along, 0 * along, depth + along], axis=1)
    np.testing.assert_array_equal(share(steep), 0)
    at_edge = level + np.array([0, side / 2, 0])
    np.testing.assert_allclose(share(at_edge), np.arctan(side / depth) / np.pi, atol=1 / 180)
    both = share(np.concatenate([level, steep + np.array([5e-3, 0, 0])]))
    np.testing.assert_allclose(both, np.repeat([2 * np.arctan(side / 2 / depth) / np.pi, 0], 7), atol=1 / 180)


def test_iterative_amplitudes_are_judged_by_their_noise_and_put_into_the_page(tmp_path):
    """Images of a kind are one line of the table, with their means, and noise decides what is too little."""
    (made,) = iterative_amplitudes.iterative_amplitudes(quick=True)
    assert 0.5 < made["amplitude"] < 1.5
    assert made["correlation"] > 0.5
    rows = [
        {**made, "noise_db": noise, "amplitude": amplitude}
        for noise, amplitude in ((30.0, 0.96), (30.0, 0.94), (20.0, 0.94), (20.0, 1.06), (None, 0.5))
    ]
    told = iterative_amplitudes.violations(rows)
    assert [re.search(r"amplitude (\S+),", line)[1] for line in told] == ["0.940", "1.060"]
    page = tmp_path / "page.md"
    page.write_text(f"before\n{iterative_amplitudes.BEGIN}\n{iterative_amplitudes.END}\nafter\n")
    iterative_amplitudes.write_page(page, rows)
    assert "| 2 vessels |" in page.read_text()
    assert "0.95 (0.94–0.96)" in page.read_text()
    assert page.read_text().endswith("after\n")
