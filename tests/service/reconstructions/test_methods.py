"""What a job makes of the parameters for iterative reconstruction, the film and non-negative pictures."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from steradian.cli.app import app
from steradian.errors import InvalidInput
from steradian.imaging.conditioning import Display
from steradian.reconstructions.job import Report, reconstruct_recording, reconstruct_scan, write_reconstruction
from steradian.reconstructions.kept_plans import KeptPlans
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.volume_file import read_volume
from steradian.scans.opening import open_recording

SIDE = 16


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """A ball below 16 × 16 sensors, as k-Wave would have written it."""
    axis = (np.arange(SIDE) - SIDE // 2) * 100e-6
    r = np.sqrt(axis[:, None] ** 2 + axis[None, :] ** 2 + 0.6e-3**2)
    ct = np.arange(100)[:, None, None] * 20e-9 * 1500.0
    p = (r - ct) / r * np.exp(-((r - ct) ** 2) / (2 * 0.1e-3**2))
    file = tmp_path / "scan.npz"
    np.savez(file, p=p.astype(np.float32), dt=20e-9, dx=100e-6, c=1500.0)
    return file


def test_the_command_line_fits_iteratively(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    options = ["--method", "iterative", "--regularisation", "sparsity", "--iterations", "4", "--film", "simulated"]
    result = CliRunner().invoke(app, ["reconstruct", str(recording), "-o", str(out), "--sound-speed", "1500", *options])
    assert result.exit_code == 0, result.output
    volume = read_volume(out / "volume.h5")
    assert volume.values.min() >= 0
    peak = np.unravel_index(volume.values.argmax(), volume.values.shape)
    assert volume.axes.z[peak[2]] == pytest.approx(0.6e-3, abs=60e-6)
    report = json.loads((out / "report.json").read_text())
    assert report["sensed_area_m2"] is None
    assert any("lowers amplitudes" in note for note in report["notes"])
    used = report["parameters"]
    assert used["iterative"]["regularisation"] == "sparsity"
    assert used["film"]["kind"] == "simulated"
    assert ReconstructionParameters.create(**used).iterative.iterations == 4


def test_bad_options_are_one_line(recording: Path, tmp_path: Path) -> None:
    for name, bad in (("film", {"kind": "gold"}), ("iterative", {"iterations": 0}), ("iterative", {"change": 2.0})):
        with pytest.raises(InvalidInput, match=next(iter(bad))):
            ReconstructionParameters.create(**{name: bad})
    wrong = ReconstructionParameters.create(film={"kind": "elastic", "speeds": (100.0, 99.0)}, sound_speed=1500.0)
    with pytest.raises(InvalidInput, match="speeds"):
        reconstruct_scan(recording, tmp_path / "out", wrong)


def test_a_corrected_film_changes_the_image_with_kept_plans_as_well(recording: Path) -> None:
    found = open_recording(recording)
    plain = ReconstructionParameters.create(sound_speed=1500.0)
    filtered = plain.replace(film={"kind": "simulated"})
    images = [reconstruct_recording(found, p, plans=KeptPlans()).values for p in (plain, filtered)]
    assert images[1].max() > 1.05 * images[0].max()
    np.testing.assert_allclose(images[1], reconstruct_recording(found, filtered).values)


def test_pictures_may_leave_out_what_is_below_zero(recording: Path) -> None:
    found = open_recording(recording)
    volume = reconstruct_recording(found, ReconstructionParameters.create(sound_speed=1500.0))
    assert volume.values.min() < 0
    shown = Display(non_negative=True).apply(volume)
    np.testing.assert_array_equal(shown.values, np.maximum(volume.values, 0))


def test_the_report_states_the_sensed_area_and_notes_weights_that_are_not_areas(
    recording: Path, tmp_path: Path
) -> None:
    """As those of scans measured before, which sum to the aperture whatever was sensed."""
    found = open_recording(recording)
    assert found.weights is not None
    chosen = ReconstructionParameters.create(sound_speed=1500.0)
    report = write_reconstruction(found, tmp_path / "new", chosen, Report())
    assert report.sensed_area_m2 == pytest.approx(found.weights.sum())
    assert report.notes == []
    old = replace(found, weights=1.27 * found.weights, outline=None)
    noted = write_reconstruction(old, tmp_path / "old", chosen, Report())
    assert any("1.27 times the area that the sensors cover" in note for note in noted.notes)
    mended = write_reconstruction(old, tmp_path / "mended", chosen.replace(weights="voronoi"), Report())
    assert mended.notes == []
    assert mended.sensed_area_m2 == pytest.approx(report.sensed_area_m2)
