"""What a job makes of the parameters for iterative reconstruction, the film and non-negative pictures."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from typer.testing import CliRunner

from steradian.cli.app import app
from steradian.cli.reconstruction_summary import _fit as told_of
from steradian.core.exceptions import InvalidInput
from steradian.imaging import Volume
from steradian.imaging.engines.cuda import array_backend
from steradian.imaging.iterative.base import StopReason
from steradian.imaging.signal.conditioning import Display
from steradian.reconstructions.live.preview import CoarseParameters
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.diagnostics import FitDiagnostics
from steradian.reconstructions.pipeline.plan_cache import PlanCache
from steradian.reconstructions.pipeline.resolve import resolve_setup
from steradian.reconstructions.pipeline.run import (
    Report,
    reconstruct_and_write,
    reconstruct_in_memory,
    reconstruct_scan,
)
from steradian.reconstructions.volumes.file import read_volume
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


@pytest.mark.long
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


@pytest.mark.parametrize("stopped", get_args(StopReason))
def test_iteration_stop_reason_is_reported(stopped: str) -> None:
    """By the command, in words; with what it cost."""
    said = told_of(Report(fit=FitDiagnostics(3, stopped, 11, 0.25, (1.0, 0.25))))
    assert "(" in str(said["iterations"])
    assert 11 in said.values()


def test_bad_options_are_one_line(recording: Path, tmp_path: Path) -> None:
    for name, bad in (("film", {"kind": "gold"}), ("iterative", {"iterations": 0}), ("iterative", {"change": 2.0})):
        with pytest.raises(InvalidInput, match=next(iter(bad))):
            ReconstructionParameters.create(**{name: bad})
    wrong = ReconstructionParameters.create(film={"kind": "elastic", "speeds": (100.0, 99.0)}, sound_speed=1500.0)
    with pytest.raises(InvalidInput, match="speeds"):
        reconstruct_scan(recording, tmp_path / "out", wrong)


def test_film_correction_changes_image_with_cached_plans(recording: Path) -> None:
    found = open_recording(recording)
    plain = ReconstructionParameters.create(sound_speed=1500.0)
    filtered = plain.replace(film={"kind": "simulated"})
    images = [reconstruct_in_memory(found, p, plans=PlanCache()).values for p in (plain, filtered)]
    assert images[1].max() > 1.05 * images[0].max()
    np.testing.assert_allclose(images[1], reconstruct_in_memory(found, filtered).values)


@pytest.mark.long
def test_highest_frequency_option_band_limits_image_and_report(recording: Path, tmp_path: Path) -> None:
    """The ball's A-lines end near 5 MHz; Nyquist is 25 MHz."""

    def run(*options: str) -> tuple[dict[str, Any], Volume, str]:
        out = tmp_path / "-".join(("out", *options))
        command = ["reconstruct", str(recording), "-o", str(out), *options]
        result = CliRunner().invoke(app, command, env={"COLUMNS": "200"})
        assert result.exit_code == 0, result.output
        return json.loads((out / "report.json").read_text()), read_volume(out / "volume.h5"), result.output

    full, whole, _ = run()
    assert full["band"] is None
    report, volume, said = run("--highest-frequency", "10MHz")
    assert report["parameters"]["highest_frequency"] == report["band"]["highest_frequency_hz"] == 10e6
    assert 0 < report["band"]["left_out"] < 0.01
    assert "below 10 MHz" in said
    assert volume.values.shape[-1] == 48
    assert report["spacing_m"][-1] == pytest.approx(20e-9 * 1500 * 100 / 48)
    found, volume, _ = run("--highest-frequency", "signal", "--depth-step", "30um")
    assert 3e6 < found["band"]["highest_frequency_hz"] == found["parameters"]["highest_frequency"] < 20e6
    np.testing.assert_allclose(volume.axes.z, whole.axes.z)
    assert np.linalg.norm(volume.values - whole.values) < 0.01 * np.linalg.norm(whole.values)
    assert ReconstructionParameters.create(**found["parameters"]).depth_step == pytest.approx(30e-6)


def test_a_limit_that_is_none_is_refused_before_anything_is_read() -> None:
    for bad in ({"highest_frequency": 0}, {"highest_frequency": "loud"}, {"depth_step": 0}):
        with pytest.raises(InvalidInput, match=next(iter(bad))):
            ReconstructionParameters.create(**bad)
    for more in ({"highest_frequency": 2e7}, {"highest_frequency": "signal"}, {"depth_step": 2e-5}):
        with pytest.raises(InvalidInput, match="iterative"):
            ReconstructionParameters.create(method="iterative", **more)


def test_options_of_the_method_iterative_are_refused_with_another(recording: Path) -> None:
    """And 1 as lateral padding is 1, not as much as the method needs."""
    with pytest.raises(InvalidInput, match="iterative is given; allowed: nothing with the method nedner"):
        ReconstructionParameters.create(iterative={"iterations": 4})
    for padding in (None, 1.0):
        chosen = ReconstructionParameters.create(method="iterative", lateral_padding=padding)
        assert resolve_setup(open_recording(recording), chosen).grid.lateral_padding == padding


def test_highest_frequency_applies_to_cached_and_incremental_plans(recording: Path) -> None:
    found = open_recording(recording)
    for highest in (10e6, "signal"):
        parameters = ReconstructionParameters.create(highest_frequency=highest)
        plain = reconstruct_in_memory(found, parameters).values
        np.testing.assert_array_equal(plain, reconstruct_in_memory(found, parameters, plans=PlanCache()).values)
    full = resolve_setup(found, parameters)
    for preview in (CoarseParameters(16, 1), CoarseParameters(16, 2)):  # what is still to come has no end of its signal
        assert preview.apply(full).method.max_frequency is None
    full = resolve_setup(found, parameters.replace(highest_frequency=10e6))
    assert CoarseParameters(16, 1).apply(full).method.max_frequency == 10e6


def test_non_negative_display_clips_negative_values(recording: Path) -> None:
    found = open_recording(recording)
    volume = reconstruct_in_memory(found, ReconstructionParameters.create(sound_speed=1500.0))
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
    report = reconstruct_and_write(found, tmp_path / "new", chosen, Report())
    assert report.sensed_area_m2 == pytest.approx(found.weights.sum())
    assert report.notes == []
    old = replace(found, weights=1.27 * found.weights, outline=None)
    noted = reconstruct_and_write(old, tmp_path / "old", chosen, Report())
    assert any("1.27 times the area that the sensors cover" in note for note in noted.notes)
    mended = reconstruct_and_write(old, tmp_path / "mended", chosen.replace(weights="voronoi"), Report())
    assert mended.notes == []
    assert mended.sensed_area_m2 == pytest.approx(report.sensed_area_m2)


@pytest.mark.long
@pytest.mark.parametrize("method", ["nedner", "iterative"])
def test_the_report_names_the_device(
    method: str, recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And says why it was not the GPU, where there is one with too little memory."""
    values = dict(np.load(recording))
    np.savez(recording, **values | {"p": values["p"][:60, 4:12, 4:12]})  # a simulated GPU is slow
    small: dict[str, Any] = {"sound_speed": 1500.0, "modes": 8, "method": method, "depth_range": (0.3e-3, 0.9e-3)}
    if method == "iterative":
        small |= {"iterative": {"iterations": 1, "refits": 0}, "lateral_padding": 1.0}
    reports, volumes = [], []
    for name in ("cpu", "auto"):
        parameters = ReconstructionParameters.create(device=name, **small)
        reports.append(reconstruct_scan(recording, tmp_path / name, parameters))
        volumes.append(read_volume(tmp_path / name / "volume.h5").values)
        if array_backend.unavailable_reason():
            monkeypatch.setenv(array_backend.USE_SIMULATOR, "simulator")
    here, there = reports
    assert (here.device, here.notes) == ("cpu", there.notes)
    assert there.device not in ("", "cpu")
    assert json.loads((tmp_path / "auto" / "report.json").read_text())["device"] == there.device
    assert np.linalg.norm(volumes[1] - volumes[0]) <= 1e-4 * np.linalg.norm(volumes[0])
    monkeypatch.setattr(type(array_backend.device()), "free", lambda _: 10_000)
    again = reconstruct_scan(recording, tmp_path / "full", ReconstructionParameters.create(device="auto", **small))
    assert again.device == "cpu"
    assert any("the GPU's memory being too small" in note for note in again.notes)


@pytest.mark.skipif(array_backend.unavailable_reason() is None, reason="there is a GPU")
def test_a_gpu_that_is_not_there_is_refused_in_words(recording: Path, tmp_path: Path) -> None:
    parameters = ReconstructionParameters.create(device="gpu", sound_speed=1500.0)
    with pytest.raises(InvalidInput, match=r"device is gpu; allowed: cpu or auto here \(.*steradian\[gpu\]"):
        reconstruct_scan(recording, tmp_path / "out", parameters)
    with pytest.raises(InvalidInput, match="device"):
        ReconstructionParameters.create(device="tpu")
