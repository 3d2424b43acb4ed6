"""Amplitudes of points that were read beside their best wavelength, corrected where asked and said so."""

from dataclasses import replace

import numpy as np
import pytest

from fabry_perot.simulator.film import Film
from steradian import Acquisition, ImageGrid, Nufft, ScanPlan, grid_mask, reconstruct
from steradian.imaging import Gridded
from steradian.plans import preview
from steradian.reconstructions.parameters import ReconstructionParameters, default_modes
from steradian.reconstructions.pipeline.run import reconstruct_in_memory
from steradian.reconstructions.shot_normalisation import ShotTreatment, normalise_new_shots, normalise_shots
from steradian.scans.file.read import read_scan
from steradian.scans.file.tail import ScanTail
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from support.alines import Aline

FILM = Film(5, "domains")
SAMPLES = 64
TRUE = 8000 * np.sin(np.arange(SAMPLES) / 3)


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    """Bands that lose up to 30 %: the film's own answer to a small pressure, by the simulator, at what was set."""
    mask = grid_mask(1e-2, 10, 8e-4)
    places = np.rint(1e9 * mask.positions).astype(int).tolist()
    best = np.array([FILM.bias(x, y) for x, y in places]) * 1e-12
    plan = ScanPlan.create(mask=mask, samples=SAMPLES, wavelengths=best, order="bands", max_sensitivity_loss=0.3)
    path = tmp_path_factory.mktemp("film") / "scan.h5"
    create_scan_file(path, plan)
    swing = np.array([1e-6])
    share = [
        FILM.transfer(x, y, bias, swing)[0] / FILM.transfer(x, y, peak, swing)[0]
        for (x, y), bias, peak in zip(places, 1e12 * plan.bias, 1e12 * best, strict=True)
    ]
    lines = [
        Aline(place, np.rint(share[row] * TRUE).astype(np.int16), place + 1, 0.5, wavelength_m=float(plan.bias[row]))
        for place, row in enumerate(plan.visit.tolist())
    ]
    with ScanFileWriter(path) as store:
        store.append(lines)
    return plan, path, np.array(share)


def pressures(recording):
    return np.asarray(recording.traces, np.float64) * np.asarray(recording.scale, np.float64)[:, None]


def test_sensitivity_correction_restores_amplitudes_and_reports_range(scan):
    plan, path, share = scan
    assert share.min() < 0.8
    plain, told = normalise_shots(read_scan(path), ShotTreatment())
    assert told.sensitivity is None
    np.testing.assert_allclose(pressures(plain), 0.5 * share[:, None] * TRUE, atol=0.3)
    corrected, told = normalise_shots(read_scan(path), ShotTreatment(correct_sensitivity=True))
    np.testing.assert_allclose(pressures(corrected), np.broadcast_to(0.5 * TRUE, (100, SAMPLES)), atol=20)
    assert told.sensitivity == pytest.approx((share.min(), share.max()), abs=5e-3), "optima are on whole picometres"
    assert 1 - told.sensitivity[0] == pytest.approx(preview(plan).sensitivity_loss["max"], abs=1e-6)


def test_reconstruction_weights_alines_by_their_sensitivity_and_the_method_without_weights_divides_them(scan):
    _, path, _ = scan
    shots = ShotTreatment(correct_sensitivity=True)
    recording, _ = normalise_shots(read_scan(path), shots)
    about = {"dt": recording.sampling_interval, "sound_speed": recording.sound_speed, "aperture": recording.aperture}
    grid = ImageGrid(default_modes(recording.grid, recording.aperture))
    for method, name in ((Nufft(max_frequency="signal"), "nedner"), (Gridded(max_frequency="signal"), "interpolated")):
        divided = name == "interpolated"
        traces = pressures(recording) * (1.0 if divided else recording.sensitivity[:, None])
        expected = reconstruct(
            Acquisition(
                traces.astype(np.float32),
                recording.positions,
                t0=recording.time_zero,
                weights=None if divided else recording.weights,
                sensitivity=None if divided else recording.sensitivity,
                **about,
            ),
            grid,
            method,
        )
        asked = ReconstructionParameters(method=name, shots=shots, highest_frequency="signal")
        found = reconstruct_in_memory(read_scan(path), asked)
        np.testing.assert_allclose(found.values, expected.values, atol=1e-4 * np.abs(expected.values).max())


def test_a_running_scan_is_corrected_alike(scan):
    _, path, _ = scan
    treatment = ShotTreatment(correct_sensitivity=True)
    followed = ScanTail(path)
    new = normalise_new_shots(followed.read_new(), followed.whole, treatment)
    whole, _ = normalise_shots(read_scan(path), treatment)
    np.testing.assert_allclose(new.traces, pressures(whole), rtol=1e-5, atol=1e-2)


def test_a_scan_that_knows_no_best_wavelengths_is_left_as_it_is(tmp_path):
    plan = ScanPlan.create(mask=grid_mask(1e-2, 3, 1e-3), samples=SAMPLES)
    create_scan_file(tmp_path / "scan.h5", plan)
    with ScanFileWriter(tmp_path / "scan.h5") as store:
        store.append([Aline(n, TRUE.astype(np.int16), n + 1, 0.5) for n in range(9)])
    recording = read_scan(tmp_path / "scan.h5")
    found, told = normalise_shots(recording, ShotTreatment(correct_sensitivity=True))
    np.testing.assert_array_equal(found.scale, np.float32(0.5))
    assert told.sensitivity == (1.0, 1.0)
    unknown = replace(recording, shots=replace(recording.shots, sensitivity=None))
    assert normalise_shots(unknown, ShotTreatment(correct_sensitivity=True))[1].sensitivity is None
