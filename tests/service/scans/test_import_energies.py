"""Pulse energies in files of laboratories: kept with the A-lines, whatever their order, and divided out of images."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from test_import_axes import DT, SPEED, imported, plane, sensed
from test_import_matlab_order import by_h5py, by_matlab_7_3, by_scipy

from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.run import reconstruct_scan
from steradian.reconstructions.volumes.file import read_volume

POINTS = plane(11, 11)
ENERGIES = np.random.default_rng(4).uniform(0.4, 2.2, len(POINTS)) * 3e-3


def by_numpy(path, **variables):
    np.savez(path.with_suffix(".npz"), **variables)
    return path.with_suffix(".npz")


@pytest.mark.parametrize("form", [(-1,), (-1, 1), (1, -1)])
@pytest.mark.parametrize("name", ["energies", "energy", "pulse_energies", "pulse_energy"])
@pytest.mark.parametrize("write", [by_numpy, by_h5py, by_matlab_7_3, by_scipy])
def test_import_normalises_pulse_energies_to_their_mean(tmp_path, write, name, form):
    lines = sensed(POINTS)
    stated = {"sensor_data": lines, "positions": POINTS, "dt": DT, "c": SPEED, name: ENERGIES.reshape(form)}
    recording, made = imported(tmp_path, write(tmp_path / "a", **stated))
    np.testing.assert_allclose(recording.shots.energy, ENERGIES / ENERGIES.mean(), rtol=1e-6)
    assert any("pulse energies" in note for note in made.notes)


def test_image_of_pulses_of_any_energy_is_that_of_equal_ones(tmp_path):
    about = {"positions": POINTS, "dt": DT, "c": SPEED}
    strength = ENERGIES / ENERGIES.mean()
    np.savez(tmp_path / "equal.npz", traces=sensed(POINTS), **about)
    np.savez(tmp_path / "unequal.npz", traces=sensed(POINTS) * strength[:, None], energies=ENERGIES, **about)
    images = []
    for name in ("equal", "unequal"):
        reconstruct_scan(tmp_path / f"{name}.npz", tmp_path / name, ReconstructionParameters.create(modes=22))
        images.append(read_volume(tmp_path / name / "volume.h5").values)
    np.testing.assert_allclose(images[1], images[0], atol=1e-5 * images[0].max())


def test_energies_that_fit_nothing_are_noted_and_not_used(tmp_path):
    stated = {"sensor_data": sensed(POINTS), "positions": POINTS, "dt": DT, "c": SPEED, "energies": ENERGIES[:7]}
    recording, made = imported(tmp_path, by_numpy(tmp_path / "a", **stated))
    np.testing.assert_array_equal(recording.shots.energy, 1)
    assert any("7 pulse energies are not used" in note for note in made.notes)


def test_import_of_frame_energies_accepts_either_axis_order(tmp_path):
    lines = np.stack([sensed(POINTS), 2 * sensed(POINTS)])
    each = np.outer([1.0, 2.0], np.ones(len(POINTS)))
    for number, energies in enumerate((each, each.T, np.array([1.0, 2.0]))):
        folder = tmp_path / str(number)
        folder.mkdir()
        source = by_numpy(folder / "a", traces=lines, positions=POINTS, dt=DT, c=SPEED, energies=energies)
        _, made = imported(folder, source, axes="frame, sensor, time")
        from steradian.scans.opening import open_recording

        found = [open_recording(made.path, frame).shots.energy for frame in (0, 1)]
        np.testing.assert_allclose(found[0], 2 / 3, rtol=1e-6)
        np.testing.assert_allclose(found[1], 4 / 3, rtol=1e-6)
