"""The film of a simulated scan: its file states it, and a correction takes back what it took away and no more."""

import h5py
import numpy as np
import pytest

import steradian
from fabry_perot.simulator import launch
from steradian import ScanPlan, grid_mask
from steradian.reconstructions.film_response_choice import Film
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.run import reconstruct_scan
from steradian.scans.acquisition.run import run_scan
from steradian.scans.importing import import_scan

MASK = grid_mask(3e-3, 12, 0.25e-3)


def scan_through(film, folder):
    with launch(film=film, speed=50.0, noise_db=float("inf"), energy_jitter=0.0) as simulator:
        run_scan(ScanPlan.create(mask=MASK, samples=700), simulator.url, folder / "scan.h5")
    return folder / "scan.h5"


def image(scan, film, folder):
    parameters = ReconstructionParameters.create(modes=24, film={"kind": film})
    report = reconstruct_scan(scan, folder, parameters)
    return report.notes, np.asarray(steradian.open(folder / "volume.h5").values)


@pytest.fixture(scope="module")
def ideal(tmp_path_factory):
    return scan_through("ideal", tmp_path_factory.mktemp("ideal"))


def test_simulated_scan_file_records_film_and_import_preserves_it(ideal, tmp_path):
    import_scan(ideal, tmp_path / "again.h5")
    for path in (ideal, tmp_path / "again.h5"):
        with h5py.File(path) as file:
            assert file.attrs["film"] == "ideal"


def test_simulated_film_correction_leaves_ideal_film_image_unchanged(ideal, tmp_path):
    none, wanted = image(ideal, "ideal", tmp_path / "a")
    notes, values = image(ideal, "simulated", tmp_path / "b")
    np.testing.assert_array_equal(values, wanted)
    assert (none, notes) == ([], ["the scan's film was ideal: nothing was corrected"])


def test_other_correction_of_an_ideal_film_is_called_too_much(ideal, tmp_path):
    notes, _ = image(ideal, "rule", tmp_path)
    assert notes == ["the scan's film was ideal: the correction amplifies what was not lost"]


@pytest.mark.long
def test_uncorrected_film_response_is_noted_in_report(ideal, tmp_path):
    scan = scan_through("bandlimited", tmp_path)
    notes, plain = image(scan, "ideal", tmp_path / "a")
    assert notes == ["the scan's film has a response (bandwidth) that was not corrected: --film simulated does"]
    notes, corrected = image(scan, "simulated", tmp_path / "b")
    assert notes == []
    _, wanted = image(ideal, "ideal", tmp_path / "c")
    assert np.linalg.norm(corrected - wanted) < 0.05 * np.linalg.norm(plain - wanted)


def test_simulated_film_correction_restores_only_recorded_losses():
    film, frequencies, sines = Film(kind="simulated"), np.array([1e6, 60e6]), np.array([0.0, 0.5, 0.8])
    at = {
        lost: film.correction(lost).response.evaluate(frequencies, sines, 1500.0)
        for lost in ("bandwidth", "directivity")
    }
    np.testing.assert_allclose(at["bandwidth"], at["bandwidth"][:, :1] * np.ones(3))
    np.testing.assert_allclose(at["directivity"], at["directivity"][:1] * np.ones((2, 1)))
    np.testing.assert_allclose(
        film.correction("bandwidth, directivity").response.evaluate(frequencies, sines, 1500.0),
        at["bandwidth"] * at["directivity"],
    )
    assert film.correction("ideal") is None
    assert film.correction("nonlinear") is None
    assert film.notes() == (
        "the scan does not state its film's response; corrected as for a simulated film with all of it",
    )
