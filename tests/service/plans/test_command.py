"""``steradian plan`` tells the cost, and writes no plan that cannot be run."""

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from steradian import InvalidInput, ScanPlan, grid_mask
from steradian.cli.plan import plan
from steradian.core.exceptions import DamagedFile
from steradian.masks import Mask, write_mask
from steradian.plans.files import read_json

app = typer.Typer()
app.command()(plan)


@pytest.fixture
def mask(tmp_path):
    write_mask(grid_mask(1e-2, 12, 5e-4), tmp_path / "mask.json")
    return tmp_path / "mask.json"


def run(*words):
    """Run the command; its errors come through as exceptions."""
    return CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)


def test_plan_command_prints_cost_and_writes_plan(mask, tmp_path):
    """Time, what limits it and the travel are shown; a picture is drawn."""
    result = run(mask, "--order", "progressive", "--plot", tmp_path / "plan.png", "-o", tmp_path / "plan.json")
    assert result.exit_code == 0
    assert "limited by the laser" in result.output
    assert "usable after" in result.output
    assert read_json(ScanPlan, tmp_path / "plan.json").order == "progressive"
    assert (tmp_path / "plan.png").exists()


def test_a_plan_the_link_cannot_carry_is_not_written(mask, tmp_path):
    """The error names what would do."""
    with pytest.raises(InvalidInput, match="refused"):
        run(mask, "--pulse-rate", "2kHz", "--baud", "115200", "-o", tmp_path / "plan.json")
    assert not (tmp_path / "plan.json").exists()


def test_plan_command_with_tuning_map_makes_bands_and_prints_loss(mask, tmp_path):
    """A map of the mask's own points; what is set differs from the best, within the loss that was allowed."""
    places = read_json(Mask, mask).positions
    best = 1550 + np.random.default_rng(0).uniform(-2, 2, len(places))
    table = np.column_stack([1e3 * places, best])
    np.savetxt(tmp_path / "map.csv", table, delimiter=",", header="x_mm,y_mm,wavelength_nm", comments="", fmt="%.9f")
    words = (mask, "--tuning", tmp_path / "map.csv", "--pulse-rate", "1kHz", "--baud", 0, "-o", tmp_path / "plan.json")
    told = run(*words, "--max-sensitivity-loss", 0.2, "--retuning", "5ms").output
    assert "sensitivity lost" in told
    assert "at most 20 %" in told
    made = read_json(ScanPlan, tmp_path / "plan.json")
    assert (made.order, made.max_sensitivity_loss, made.tuning.settling) == ("bands", 0.2, 5e-3)
    np.testing.assert_allclose(made.wavelengths, 1e-9 * best, rtol=1e-9)
    assert len(np.unique(made.bias)) < 40
    with pytest.raises(InvalidInput, match="wavelengths"):
        run(*words, "--wavelengths", tmp_path / "map.csv")


def test_wavelengths_are_read_in_nanometres(mask, tmp_path):
    """A column of wavelengths allows the order by wavelength; nonsense is told."""
    np.savetxt(tmp_path / "bias.csv", 1550 + np.arange(144) % 4)
    words = (mask, "--order", "wavelength", "--wavelengths", tmp_path / "bias.csv", "-o", tmp_path / "plan.json")
    assert "retunings" in run(*words).output
    assert read_json(ScanPlan, tmp_path / "plan.json").wavelengths[1] == pytest.approx(1551e-9)
    (tmp_path / "bias.csv").write_text("red\n")
    with pytest.raises(DamagedFile, match=r"bias\.csv"):
        run(*words)


@pytest.mark.long
def test_beams_make_a_plan_of_the_points_that_they_measure(mask, tmp_path):
    result = run(mask, "--beams", "2x2", "--beam-spacing", "1mm", "--baud", 0, "-o", tmp_path / "plan.json")
    assert result.exit_code == 0, result.output
    assert "4 at 36 places" in result.output
    assert "from a measured one (median)" in result.output
    assert len(read_json(ScanPlan, tmp_path / "plan.json").beams) == 4
