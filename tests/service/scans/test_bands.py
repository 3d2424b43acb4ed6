"""A scan in bands: each point is measured at its band's wavelength, and its signal is what the fringe leaves of it."""

import h5py
import numpy as np
import pytest

from fabry_perot.simulator import launch
from steradian import ScanPlan, equi_steradian_mask
from steradian.plans import Link, Tuning, preview
from steradian.scans.acquisition.run import run_scan
from steradian.scans.file.measurement_order import ScanProgram

MASK = equi_steradian_mask(13.56e-3, 3.6e-3, 120)
OPTIONS = {"film": "nonlinear", "relief": "scatter", "noise_db": float("inf"), "energy_jitter": 0.0, "speed": 50}


@pytest.fixture(scope="module")
def scanned(tmp_path_factory):
    """Return a plan in bands and one tuned at every point, with the files of their scans."""
    from fabry_perot.simulator.film import Film

    film, folder = Film(0, "scatter"), tmp_path_factory.mktemp("bands")
    places = np.rint(1e9 * MASK.film_positions).astype(int).tolist()
    best = np.array([film.bias(x, y) for x, y in places]) * 1e-12
    common = {"mask": MASK, "wavelengths": best, "pulse_rate": 1000.0, "samples": 1024, "link": Link(byte_rate=None)}
    slow = Tuning(settling=5e-3, speed=1.0, tolerance=0.0)
    plans = {
        "bands": ScanPlan.create(order="bands", max_sensitivity_loss=0.3, tuning=slow, **common),
        "each": ScanPlan.create(order="snake", tuning=slow, **common),
    }
    for name, plan in plans.items():
        with launch(tuning_time=5e-3, **OPTIONS) as simulator:
            run_scan(plan, simulator.url, folder / f"{name}.h5")
    return plans, folder


def measured(folder, name):
    """Return wavelengths (M,) in m and A-lines (M, N_t) in the pressure unit."""
    with h5py.File(folder / f"{name}.h5") as file:
        alines = file["alines"]
        return np.asarray(alines["wavelength_m"]), np.asarray(alines["samples"]) * np.asarray(alines["scale"])[:, None]


@pytest.mark.long
def test_each_point_is_measured_at_its_bands_wavelength(scanned):
    """The wavelength that the scanner says it had, to a picometre; and retunings are few."""
    plans, folder = scanned
    plan = plans["bands"]
    np.testing.assert_allclose(measured(folder, "bands")[0], plan.bias, atol=0.51e-12)
    assert preview(plan).retunings < 30
    assert len(np.unique(measured(folder, "each")[0])) > 100


def test_banded_wavelengths_reduce_signal_as_fringe_predicts(scanned):
    """Beside the same points at their best wavelengths: on average to half a per cent, each to a few."""
    plans, folder = scanned
    plan = plans["bands"]
    (_, banded), (_, best) = measured(folder, "bands"), measured(folder, "each")
    kept = (banded * best).sum(axis=1) / (best**2).sum(axis=1)
    expected = 1 - plan.fringe.sensitivity_loss(plan.bias - plan.wavelengths)
    assert kept.min() > 0.65
    assert kept.mean() == pytest.approx(expected.mean(), abs=5e-3)
    assert np.abs(kept - expected).max() < 0.05


def test_scan_file_stores_planned_and_bias_wavelengths_and_resumes_at_bias(scanned):
    """What is missing after an interruption would be measured as planned."""
    plans, folder = scanned
    with h5py.File(folder / "bands.h5") as file:
        np.testing.assert_array_equal(file["plan/wavelengths"], plans["bands"].wavelengths)
        np.testing.assert_array_equal(ScanProgram.of_file(file).wavelengths, plans["bands"].bias)
        del_bias = {name: np.asarray(file[f"plan/{name}"]) for name in ("wavelengths", "bias")}
    assert np.abs(del_bias["bias"] - del_bias["wavelengths"]).max() > 20e-12
