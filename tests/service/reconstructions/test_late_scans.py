"""Scans whose records begin late after the laser pulse: volume, report, live view, what-if and speed of sound."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from steradian.cli.app import app
from steradian.core.exceptions import InvalidInput
from steradian.imaging import Volume
from steradian.masks import grid_mask
from steradian.phantoms import Balls, pressure
from steradian.plans import ScanPlan
from steradian.reconstructions.live.follow import LiveReconstruction
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.run import reconstruct_in_memory, reconstruct_scan
from steradian.reconstructions.studies import medium_fit
from steradian.reconstructions.studies.sound_speed_search import find_sound_speed, scan_sound_speed
from steradian.reconstructions.studies.what_if import compare_subset
from steradian.reconstructions.volumes.file import read_volume
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from steradian.scans.opening import open_recording
from support.alines import Aline

SPEED, INTERVAL, SAMPLES, LATE = 1500.0, 20e-9, 150, 3e-6
STEP = SPEED * INTERVAL
CENTRE = (0.4e-3, -0.2e-3, 5.0e-3)
MASK = grid_mask(4e-3, 16, 0.25e-3)
PLAN = ScanPlan.create(mask=MASK, samples=SAMPLES, sampling_interval=INTERVAL, sound_speed=SPEED)
PARAMETERS = ReconstructionParameters.create(modes=32)
SCALE = 1 / 60_000


def sound(positions: np.ndarray, begins: float) -> np.ndarray:
    balls = Balls(np.array([CENTRE]), np.array([0.1e-3]), np.array([1.0]))
    return pressure(
        balls, positions, samples=SAMPLES, sampling_interval=INTERVAL, sound_speed=SPEED, time_zero=begins, threads=1
    )


def scan_of(path: Path, begins: float | np.ndarray = LATE) -> Path:
    """Write a scan of the ball whose A-lines begin at one time after the pulse, or each at its own (M,)."""
    create_scan_file(path, PLAN, simulated=True)
    each, lines = np.broadcast_to(begins, MASK.count), []
    for point, place in enumerate(PLAN.visit.tolist()):
        begin = float(each[place])
        line = sound(MASK.positions[place : place + 1], begin)[0]
        lines.append(Aline(point, np.rint(line / SCALE).astype(np.int16), scale=SCALE, time_zero_offset_s=begin))
    with ScanFileWriter(path) as store:
        store.append(lines)
    return path


@pytest.fixture(scope="module")
def late(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return scan_of(tmp_path_factory.mktemp("late") / "scan.h5")


def peak(volume: Volume) -> tuple[float, ...]:
    found = np.unravel_index(volume.values.argmax(), volume.values.shape)
    return tuple(float(volume.coordinates(name)[n]) for name, n in zip(volume.names, found, strict=True))


def near_the_ball(volume: Volume) -> None:
    np.testing.assert_allclose(peak(volume), CENTRE, atol=1.01 * max(volume.spacing[0], volume.spacing[-1]))


@pytest.mark.parametrize("method", ["nedner", "iterative"])
def test_late_scan_image_keeps_depth_and_report_notes_missing_range(late: Path, tmp_path: Path, method: str) -> None:
    report = reconstruct_scan(late, tmp_path, PARAMETERS.replace(method=method))
    volume = read_volume(tmp_path / "volume.h5")
    near_the_ball(volume)
    assert (report.shape[-1], report.origin_m[-1]) == (SAMPLES, pytest.approx(4.5e-3))
    assert read_volume(tmp_path / "volume.h5").axes.z[0] == pytest.approx(4.5e-3)
    note, *others = json.loads((tmp_path / "report.json").read_text())["notes"]
    assert len(others) == (method == "iterative")  # of the depth at which the record ends
    assert "begin 3 µs after the laser pulse: what lies less deep than 4.5 mm" in note
    assert "where the image begins" in note


def test_late_scan_may_be_shown_from_the_film_to_its_last_sample(late: Path) -> None:
    recording = open_recording(late)
    usual = reconstruct_in_memory(recording, PARAMETERS)
    whole = reconstruct_in_memory(recording, PARAMETERS.replace(depth_range=(0.0, None)))
    assert whole.values.shape[-1] == 300
    near_the_ball(whole)
    for first, last, ends in ((None, 7e-3, (150, 233)), (None, 3e-3, (0, 100)), (6e-3, 9e-3, (200, 299))):
        part = reconstruct_in_memory(recording, PARAMETERS.replace(depth_range=(first, last)))
        np.testing.assert_allclose(part.axes.z[[0, -1]], np.array(ends) * STEP, rtol=1e-9)
    assert usual.values.max() == pytest.approx(whole.values.max(), rel=1e-3)
    with pytest.raises(InvalidInput, match=r"depth_range is .*within 0 … 0\.009$"):
        reconstruct_in_memory(recording, PARAMETERS.replace(depth_range=(0.0, 9.1e-3)))
    with pytest.raises(InvalidInput, match="depth_range"):
        reconstruct_in_memory(recording, PARAMETERS.replace(depth_range=(0.01, None)))


def test_trigger_delay_counts_like_the_record_s_own_time_zero(late: Path, tmp_path: Path) -> None:
    recording = open_recording(late)
    delayed = replace(recording, time_zero=1e-6, shots=None)
    parameters = PARAMETERS.replace(conditioning={"delay": 2e-6})
    image, truth = (reconstruct_in_memory(*each) for each in ((delayed, parameters), (recording, PARAMETERS)))
    np.testing.assert_allclose(image.axes.z, truth.axes.z, rtol=1e-9)
    np.testing.assert_allclose(image.values, truth.values, atol=1e-5 * truth.values.max())
    pick_up = parameters.replace(conditioning={"delay": 2e-6, "zero_first": 5})
    near_the_ball(reconstruct_in_memory(delayed, pick_up))
    with pytest.raises(InvalidInput, match=r"delay is 0\.5; allowed: at least -0\.0005, at most 0\.0005 \(s\)"):
        parameters.replace(conditioning={"delay": 0.5})


def test_a_lines_that_begin_late_each_at_its_own_time_show_the_ball(tmp_path: Path) -> None:
    begins = LATE + np.random.default_rng(2).integers(0, 3000, MASK.count) * 1e-10
    volume = reconstruct_in_memory(open_recording(scan_of(tmp_path / "scan.h5", begins)), PARAMETERS)
    near_the_ball(volume)
    assert volume.axes.z[0] == pytest.approx(np.ceil(begins.min() / INTERVAL) * STEP)
    assert volume.axes.z[-1] >= SPEED * (begins.max() + (SAMPLES - 2) * INTERVAL)


def test_live_view_of_a_late_scan_has_the_depths_of_the_final_image(late: Path, tmp_path: Path) -> None:
    for detail in ("preview", "full"):
        view = LiveReconstruction(late, tmp_path, PARAMETERS, detail)  # type: ignore[arg-type]
        assert view.update() is not None
        near_the_ball(view.volume())
        depths = view.volume().axes.z
        step = depths[1] - depths[0]
        assert 4.5e-3 - 1e-9 <= depths[0] < 4.5e-3 + step
        assert 9e-3 - 2 * step <= depths[-1] < 9e-3 + step


def test_late_scan_subset_comparison_keeps_depth_axis(late: Path, tmp_path: Path) -> None:
    report = compare_subset(late, grid_mask(4e-3, 8, 0.5e-3), tmp_path, PARAMETERS)
    assert report.shape[-1] == SAMPLES
    assert report.quality["volume_correlation"] > 0.5


@pytest.mark.long
def test_speed_of_sound_of_a_late_record_is_that_of_the_zero_filled_one() -> None:
    chance, mask = np.random.default_rng(5), grid_mask(8e-3, 40, 0.2e-3)
    centres = np.column_stack([chance.uniform(-2.5e-3, 2.5e-3, (12, 2)), chance.uniform(5e-3, 7.5e-3, 12)])
    balls = Balls(centres, np.full(12, 0.12e-3), np.ones(12))
    about = {"sampling_interval": INTERVAL, "sound_speed": 1470.0, "threads": 1}
    late = pressure(balls, mask.positions, samples=200, time_zero=LATE, **about)
    filled = np.concatenate([np.zeros((mask.count, 150), np.float32), late], axis=1)
    known = {"sampling_interval": INTERVAL, "aperture": mask.aperture, "weights": mask.weights}
    known |= {"sound_speeds": np.linspace(1410, 1530, 5), "standard_error": False, "criterion": "sharpness"}
    for times in ((4.5e-3 / 1500, 8e-3 / 1500), (3e-6, 6.98e-6)):
        one, other = (
            find_sound_speed(traces, mask.positions, depth_times=times, time_zero=begins, **known)
            for traces, begins in ((late, LATE), (filled, 0.0))
        )
        assert one.best == pytest.approx(1470, rel=0.01)
        assert one.best == pytest.approx(other.best, abs=2.0)


@pytest.mark.long
def test_speed_search_of_a_late_scan_takes_a_depth_range_of_its_record(
    late: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, few in (("ROUNDS", 1), ("SUPPORT_STEPS", 2), ("STEPS", 2)):
        monkeypatch.setattr(medium_fit, name, few)
    wanted = PARAMETERS.replace(depth_range=(4.6e-3, 8.9e-3))
    assert scan_sound_speed(late, tmp_path, wanted, first=1450, last=1550, steps=3).sharpness[0] > 0


def test_reconstruct_command_warns_of_late_record_start(late: Path, tmp_path: Path) -> None:
    said = CliRunner().invoke(app, ["reconstruct", str(late), "--output", str(tmp_path / "out"), "--modes", "16"])
    assert said.exit_code == 0, said.output
    text = " ".join(said.output.split())
    assert "A-lines begin 3 µs after the laser pulse" in text
    assert "from 4.50 mm depth" in text
    said = CliRunner().invoke(
        app, ["reconstruct", str(late), "--output", str(tmp_path / "b"), "--modes", "16", "--last-depth", "10mm"]
    )
    assert "within 0 … 0.009" in str(said.exception)
