"""Preview of a plan's excitation wavelengths against the spectra and against a simulation of noise."""

import numpy as np
import pytest

from steradian import InvalidInput, ScanPlan, equi_steradian_mask, grid_mask
from steradian.plans import preview_excitation
from steradian.spectroscopy import TissueFluence, chromophore
from support.commands import run_here

MASK = equi_steradian_mask(8e-3, 2e-3, 60)


def plan(*nanometres, **options):
    return ScanPlan.create(mask=MASK, excitation=tuple(1e-9 * each for each in nanometres), **options)


def test_expected_error_is_that_of_noisy_spectra_of_blood_at_the_depth():
    found = preview_excitation(plan(750, 850, frames=4), noise=0.02)
    assert found.depth == MASK.depth
    assert found.noise == pytest.approx(0.01)
    light, random = np.array([750e-9, 850e-9]), np.random.default_rng(0)
    blood = 150 / 64_500 * np.column_stack([chromophore(name).at(light) for name in ("HbO2", "Hb")])
    many = 1e-9 * np.arange(700, 901, 10)
    surface = max(150 / 64_500 * (0.75 * chromophore("HbO2").at(many) + 0.25 * chromophore("Hb").at(many)))
    matrix = np.exp(-TissueFluence().attenuation(light) * MASK.depth)[:, None] * blood / surface
    squares = []
    for saturation in np.linspace(0.5, 1.0, 6):
        clean = matrix @ [saturation, 1 - saturation]
        pairs = np.linalg.solve(matrix, clean[:, None] + 0.01 * random.standard_normal((2, 20_000)))
        squares.append(np.mean((pairs[0] / pairs.sum(axis=0) - saturation) ** 2))
    assert found.saturation_error == pytest.approx(np.sqrt(np.mean(squares)), rel=0.05)
    columns = matrix / np.linalg.norm(matrix, axis=0)
    assert found.condition == pytest.approx(np.linalg.cond(columns))


def test_plans_without_enough_wavelengths_have_a_reason():
    assert preview_excitation(plan()).reason == "the plan states no excitation wavelengths"
    assert "wavelengths is 1; allowed: at least 2" in preview_excitation(plan(800)).reason
    assert "allowed: 600 to 1000 nm" in preview_excitation(plan(532, 800)).reason
    flat = ScanPlan.create(mask=grid_mask(2e-3, 4, 0.5e-3), excitation=(750e-9, 850e-9))
    assert preview_excitation(flat).depth == pytest.approx(3e-3)
    with pytest.raises(InvalidInput, match=r"depth is 1\.0; allowed: 0 to 0\.1 m"):
        preview_excitation(plan(750, 850), depth=1.0)


def test_plan_with_a_point_of_interest_deeper_than_light_reaches_has_a_reason():
    deep = ScanPlan.create(mask=equi_steradian_mask(0.05, 0.2, 100), excitation=(750e-9, 850e-9))
    found = preview_excitation(deep)
    assert found.saturation_error is None
    assert "depth is 0.2; allowed: 0 to 0.1 m" in found.reason


def test_plan_command_shows_expected_error_and_condition(tmp_path):
    MASK.save(tmp_path / "mask.json")
    words = ("plan", "mask.json", "--excitation", "750nm", "--excitation", "850nm", "--blood-depth", "2mm")
    told = " ".join(run_here(*words, cwd=tmp_path).split())
    expected = preview_excitation(plan(750, 850), depth=2e-3)
    assert f"± {expected.saturation_error:.2g} of a voxel at 2 mm" in told
    assert f"condition {expected.condition:.3g}" in told
    told = run_here("plan", "mask.json", "--excitation", "532nm", "--excitation", "850nm", cwd=tmp_path)
    assert "not known" in told
