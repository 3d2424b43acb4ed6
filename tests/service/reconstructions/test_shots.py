"""Shot normalisation does not show in the image: time zero, pulse energy, flagged A-lines."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fabry_perot.simulator import launch, phantoms
from steradian.core.exceptions import InvalidInput
from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.reconstructions.live.follow import LiveReconstruction
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.run import reconstruct_in_memory, reconstruct_scan
from steradian.reconstructions.shot_normalisation import ShotTreatment, normalise_shots
from steradian.scans.acquisition.run import run_scan
from steradian.scans.file.read import read_scan
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from steradian.scans.opening import open_recording
from support.alines import Aline

CENTRE = np.array([0.3e-3, -0.2e-3, 1.2e-3])
SPEED, INTERVAL, SAMPLES = 1500.0, 8e-9, 400
PLAN = ScanPlan.create(
    mask=equi_steradian_mask(4e-3, 1.2e-3, 400), samples=SAMPLES, sampling_interval=INTERVAL, sound_speed=SPEED
)
PARAMETERS = ReconstructionParameters.create(modes=66, depth_range=(0.0, 2e-3))
BALL = phantoms.Balls(CENTRE[None], np.array([70e-6]), np.array([1.0]))
SCALE = 1 / 60_000


def measured(path: Path, energy, time_zero, flags=None) -> Path:
    """Write a scan of a ball, by its closed form: every A-line with its energy (M,), time zero and quality (M,)."""
    create_scan_file(path, PLAN)
    times, lines = np.arange(SAMPLES) * INTERVAL, []
    for point, place in enumerate(PLAN.visit.tolist()):
        begin = float(np.broadcast_to(time_zero, len(PLAN.visit))[place])
        pressure = phantoms.pressure(BALL, PLAN.mask.positions[place : place + 1], begin + times, SPEED)[0]
        strength = float(np.broadcast_to(energy, len(PLAN.visit))[place])
        quality = 0 if flags is None else int(flags[place])
        if quality:
            pressure = np.full(SAMPLES, 0.5)
        counts = np.rint(pressure * strength / SCALE).astype(np.int16)
        about = {"energy": strength, "time_zero_offset_s": begin, "quality": quality}
        lines.append(Aline(point, counts, scale=SCALE, **about))
    with ScanFileWriter(path) as store:
        store.append(lines)
    return path


@pytest.fixture(scope="module")
def chance():
    return np.random.default_rng(11)


@pytest.fixture(scope="module")
def even(tmp_path_factory):
    return measured(tmp_path_factory.mktemp("even") / "scan.h5", 1.0, 0.0)


@pytest.fixture(scope="module")
def uneven(tmp_path_factory):
    """Energies of 0.8 to 1.2 and time zeros of 0 to 0.5 µs, 0.75 mm, to 100 ps."""
    chance = np.random.default_rng(11)
    energy, begin = chance.uniform(0.8, 1.2, PLAN.mask.count), chance.integers(0, 5000, PLAN.mask.count) * 1e-10
    return measured(tmp_path_factory.mktemp("uneven") / "scan.h5", energy, begin)


def peak(volume):
    """Place and height of the maximum."""
    index = np.unravel_index(volume.values.argmax(), volume.values.shape)
    axes = volume.axes.x, volume.axes.y, volume.axes.z
    return np.array([axis[i] for axis, i in zip(axes, index, strict=True)]), float(volume.values.max())


def image(path, **shots):
    recording = open_recording(path)
    return reconstruct_in_memory(recording, PARAMETERS.replace(shots=ShotTreatment.create(**shots)))


@pytest.mark.long
def test_a_ball_recorded_with_uneven_energies_and_time_zeros_has_its_true_depth_and_amplitude(even, uneven):
    place, height = peak(image(even))
    step = SPEED * INTERVAL
    assert place[2] == pytest.approx(CENTRE[2], abs=step)
    found, strength = peak(image(uneven))
    assert found == pytest.approx(CENTRE, abs=31e-6), "half a lateral voxel"
    assert found[2] == pytest.approx(CENTRE[2], abs=step)
    assert strength == pytest.approx(height, rel=0.005)
    values, truth = image(uneven).values, image(even).values
    assert np.abs(values - truth).max() < 0.005 * height


@pytest.mark.long
def test_each_correction_may_be_left_out_and_then_misses(even, uneven):
    """… so the test above is worth its name."""
    _, height = peak(image(even))
    assert peak(image(uneven, time_zero="common"))[1] < 0.6 * height
    difference = image(uneven, normalise_energy=False).values - image(even).values
    assert np.abs(difference).max() > 0.01 * height


def test_a_time_zero_that_all_a_lines_have_moves_nothing(even, tmp_path):
    """0.3 µs, which the plan knows nothing of."""
    late = open_recording(measured(tmp_path / "scan.h5", 1.0, 3e-7))
    assert late.time_zero == pytest.approx(3e-7, abs=1e-15)
    evened, _ = normalise_shots(late, ShotTreatment())
    assert evened.traces is late.traces, "nothing is shifted"
    place, height = peak(reconstruct_in_memory(late, PARAMETERS))
    truth, strength = peak(image(even))
    np.testing.assert_allclose(place, truth, atol=SPEED * INTERVAL)
    assert height == pytest.approx(strength, rel=0.005)


@pytest.mark.long
def test_saturated_and_mistuned_a_lines_are_left_out_and_the_others_make_up_for_them(even, tmp_path):
    chance = np.random.default_rng(5)
    flags = np.zeros(PLAN.mask.count, int)
    flags[chance.choice(PLAN.mask.count, 40, replace=False)] = np.repeat([1, 2], 20)
    flagged = measured(tmp_path / "scan.h5", 1.0, 0.0, flags)
    recording, found = normalise_shots(read_scan(flagged), ShotTreatment())
    assert recording.weights.sum() == pytest.approx(PLAN.mask.sensed_area)
    assert (len(recording.traces), found.left_out) == (PLAN.mask.count - 40, {"saturated": 20, "mistuned": 20})
    _, height = peak(image(even))
    place, strength = peak(image(flagged))
    assert place == pytest.approx(CENTRE, abs=31e-6)
    assert strength == pytest.approx(height, rel=0.1), "90 % of the points, the same area"
    spoilt = image(flagged, leave_out=()).values - image(even).values
    assert np.abs(spoilt).max() > 5 * np.abs(image(flagged).values - image(even).values).max()


def test_scan_with_only_flagged_alines_is_refused_with_hint(tmp_path):
    path = measured(tmp_path / "scan.h5", 1.0, 0.0, np.ones(PLAN.mask.count, int))
    with pytest.raises(InvalidInput, match=r"shots\.leave_out.*saturated, mistuned.*at least one of 405"):
        reconstruct_scan(path, tmp_path / "out", PARAMETERS)
    assert normalise_shots(read_scan(path), ShotTreatment.create(leave_out=()))[1].left_out == {}


def test_an_a_line_without_light_is_left_out_unless_no_energy_is_known(even):
    recording = read_scan(even)
    energy = recording.shots.energy.copy()
    energy[:3] = 0.0
    dark = replace(recording, shots=replace(recording.shots, energy=energy))
    assert normalise_shots(dark, ShotTreatment())[1].left_out == {"dark": 3}
    unknown = replace(recording, shots=replace(recording.shots, energy=0 * energy))
    np.testing.assert_array_equal(normalise_shots(unknown, ShotTreatment())[0].scale, recording.scale)


def test_a_lines_that_have_no_time_in_common_are_refused(even):
    recording = read_scan(even)
    begin = recording.shots.time_zero.copy()
    begin[7] = 1e-3
    apart = replace(recording, shots=replace(recording.shots, time_zero=begin))
    with pytest.raises(InvalidInput, match=r"time_zero.*1000 µs apart.*at most 3\.2 µs"):
        normalise_shots(apart, ShotTreatment())


def test_live_view_applies_shot_normalisation(even, uneven, tmp_path):
    views = []
    for path in (even, uneven):
        view = LiveReconstruction(path, tmp_path / path.parent.name, PARAMETERS, "full")
        assert view.update().points == PLAN.mask.count
        views.append(view.latest)
    assert np.abs(views[1] - views[0]).max() < 0.02 * views[0].max()


@pytest.mark.long
def test_dark_a_lines_that_come_first_are_not_left_in_the_live_view(even, tmp_path):
    """Whether energies are known is a matter of the whole scan, not of the few A-lines of one look."""
    counts, first, path = np.array(read_scan(even).traces), PLAN.visit[:40], tmp_path / "scan.h5"
    counts[first] = -counts[first]  # of whatever else they heard
    lines = [Aline(n, counts[place], scale=SCALE, energy=float(n >= len(first))) for n, place in enumerate(PLAN.visit)]
    create_scan_file(path, PLAN)
    with ScanFileWriter(path) as store:
        store.append(lines[:40])
        view = LiveReconstruction(path, tmp_path / "out", PARAMETERS, "full")
        assert view.update().points == 40, "as long as no energy is known there is nothing to divide by"
        store.append(lines[40:])
    revision = view.update()
    late = LiveReconstruction(path, tmp_path / "late", PARAMETERS, "full")
    late.update()
    difference = np.abs(view.latest - late.latest).max()
    assert difference < 1e-4 * late.latest.max()
    assert revision.points == PLAN.mask.count - 40
    assert reconstruct_scan(path, tmp_path / "final", PARAMETERS).sensors == PLAN.mask.count - 40


def test_report_states_shot_statistics_and_treatment(uneven, tmp_path):
    reconstruct_scan(uneven, tmp_path, PARAMETERS)
    report = json.loads((tmp_path / "report.json").read_text())
    low, high = report["shots"]["energy"]
    assert 0.8 <= low < 0.81 < 1.19 < high <= 1.2
    assert report["shots"]["time_zero_s"][1] == pytest.approx(5e-7, abs=2e-8)
    assert report["parameters"]["shots"]["leave_out"] == ["saturated", "mistuned"]


def test_shot_metadata_from_device_reaches_recording(tmp_path):
    """Through protocol, driver, store and file: an object 9 mm deep, whose record begins 5 µs after the pulse."""
    plan = ScanPlan.create(mask=equi_steradian_mask(4e-3, 1.2e-3, 40), samples=256, averages=3, pulse_rate=1000.0)
    with launch(speed=20.0, time_zero=5.0001e-6, noise_db=float("inf")) as simulator:
        run_scan(plan, simulator.url, tmp_path / "scan.h5")
    recording = open_recording(tmp_path / "scan.h5")
    assert recording.time_zero == pytest.approx(5.0001e-6, abs=1e-15)
    shots = recording.shots
    assert set(shots.averages) == {3}
    assert (shots.level == pytest.approx(1.2), shots.gain.any()) == (True, False)
    assert 0.9 < shots.energy.min() < shots.energy.max() < 1.1
    times = recording.time_zero + np.arange(256) * recording.sampling_interval
    truth = phantoms.pressure(phantoms.yarn(0), recording.positions, times, 1500.0)
    evened, _ = normalise_shots(recording, ShotTreatment())
    np.testing.assert_allclose(evened.traces * evened.scale[:, None], truth, atol=1.5 * float(evened.scale.max()))
