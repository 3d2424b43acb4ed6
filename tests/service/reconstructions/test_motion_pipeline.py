"""Motion in the pipeline: times of shots from the scan file, moving scans and series corrected, drawn and reported."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import steradian
from steradian import ScanPlan, Volume, equi_steradian_mask
from steradian.core.exceptions import InvalidInput
from steradian.imaging import VoxelAxes
from steradian.quality import estimate_shift
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.motion import MotionReport, correct_motion, draw_motion
from steradian.reconstructions.pipeline.run import prepare, reconstruct_scan
from steradian.reconstructions.series.alignment import Aligner
from steradian.reconstructions.series.frames import SeriesFrame
from steradian.reconstructions.series.reconstruct import reconstruct_series
from steradian.reconstructions.series.series import Series
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from steradian.scans.opening import open_recording
from support.alines import Aline
from support.commands import run_here

INTERVAL, SAMPLES, SPEED, SIZE, RATE = 20e-9, 180, 1500.0, 80e-6, 50.0
MASK = equi_steradian_mask(6e-3, 2.4e-3, 400)
RANDOM = np.random.default_rng(0)
CENTRES = np.column_stack([RANDOM.uniform(-1.2e-3, 1.2e-3, (20, 2)), RANDOM.uniform(1.3e-3, 3e-3, 20)])
FAST = {"modes": 36, "depth_range": (0.8e-3, 3.6e-3)}


def lines(shifts, seed):
    """A-lines of balls in closed form, the object shifted (M, 3) at each point's time; noise at 30 dB."""
    time, made = np.arange(SAMPLES) * INTERVAL, 0.0
    for centre in CENTRES:
        aside = MASK.positions - (centre[:2] + shifts[:, :2])
        distance = np.sqrt((aside**2).sum(axis=1) + (centre[2] + shifts[:, 2]) ** 2)[:, None]
        late = distance - SPEED * time
        made = made + late * np.exp(-(late**2) / (2 * SIZE**2)) / (2 * distance)
    noise = np.abs(made).max() * 10**-1.5 * np.random.default_rng(seed).standard_normal(made.shape)
    return made + noise


def write_scan(path, shifts_at, *, order="progressive", frames=1, fired=True):
    """Write a scan of an object whose shift is a function of time; without ``fired`` shots have numbers only."""
    plan = ScanPlan.create(
        mask=MASK, samples=SAMPLES, sampling_interval=INTERVAL, pulse_rate=RATE, order=order, frames=frames
    )
    create_scan_file(path, plan)
    visit = np.asarray(plan.visit)
    with ScanFileWriter(path) as store:
        for frame in range(frames):
            shot = np.arange(MASK.count) + frame * MASK.count
            times = np.empty(MASK.count)
            times[visit] = shot / RATE
            made = lines(shifts_at(times), frame)
            made = (2e4 * made / np.abs(made).max()).round().astype(np.int16)
            store.append(
                Aline(frame * MASK.count + n, made[point], shot=int(shot[n]),
                      fire_time_s=shot[n] / RATE if fired else 0.0)
                for n, point in enumerate(visit)
            )  # fmt: skip
    return path


def still(times):
    return np.zeros((len(times), 3))


def breathing(times):
    return np.maximum(0, np.sin(2 * np.pi * times / 3))[:, None] ** 2 * np.array([0.0, 0.0, 120e-6])


@pytest.mark.parametrize("fired", [True, False])
def test_times_of_shots_come_from_the_scanner_or_from_their_numbers(tmp_path, fired):
    path = write_scan(tmp_path / "scan.h5", still, fired=fired)
    recording = open_recording(path)
    order = np.argsort(recording.times)
    np.testing.assert_allclose(recording.times[order], np.arange(MASK.count) / RATE)


@pytest.mark.long
def test_breathing_is_undone_drawn_and_reported(tmp_path):
    path = write_scan(tmp_path / "scan.h5", breathing)
    told = run_here("reconstruct", path, "--motion", "--modes", "36", "--first-depth", "0.8mm", "--last-depth", "3.6mm",
                    cwd=tmp_path)  # fmt: skip
    assert "undone" in told
    report = json.loads((tmp_path / "reconstruction" / "report.json").read_text())["motion"]
    assert report["corrected"]
    knots, found = np.array(report["times_s"]), np.array(report["shifts_m"])
    truth = breathing(knots) - breathing(np.arange(MASK.count) / RATE).mean(axis=0)
    assert np.sqrt(np.mean((found - truth) ** 2, axis=0)).max() < 25e-6
    with Image.open(tmp_path / "reconstruction" / "motion.png") as drawn:
        assert drawn.width > 500
    corrected = steradian.open(tmp_path / "reconstruction")
    plain = steradian.open(path).reconstruct(**FAST)
    assert corrected.values.max() > 1.1 * plain.values.max()


@pytest.mark.long
def test_still_scan_is_reported_and_left_as_it_is(tmp_path):
    path = write_scan(tmp_path / "scan.h5", still)
    parameters = ReconstructionParameters.create(**FAST)
    report = reconstruct_scan(path, tmp_path / "out", parameters, motion=True)
    assert not report.motion.corrected
    assert max(report.motion.rms_m) < 20e-6
    plain = steradian.open(path).reconstruct(**FAST)
    np.testing.assert_array_equal(steradian.open(tmp_path / "out").values, plain.values)


@pytest.fixture(scope="module")
def jumping(tmp_path_factory):
    """A scan of two frames, the object 150 µm deeper and 80 µm aside in the second."""
    path = tmp_path_factory.mktemp("scan") / "scan.h5"
    return write_scan(
        path, lambda times: (times[:, None] >= MASK.count / RATE) * np.array([80e-6, 0, 150e-6]), frames=2
    )


@pytest.mark.long
def test_aligned_series_lists_and_draws_shifts(jumping, tmp_path):
    told = run_here("reconstruct", jumping, "--align", "--modes", "36", "--first-depth", "0.8mm", "--last-depth",
                    "3.6mm", cwd=tmp_path)  # fmt: skip
    assert "1 of 2 volumes moved back" in told
    report = json.loads((tmp_path / "reconstruction" / "report.json").read_text())
    first, second = (frame["shift"] for frame in report["frames"])
    assert not first["corrected"]
    assert second["corrected"]
    np.testing.assert_allclose(second["metres"], [80e-6, 0, 150e-6], atol=15e-6)
    assert "shifts.png" in report["files"]
    with Image.open(tmp_path / "reconstruction" / "shifts.png") as drawn:
        assert drawn.width > 500
    series = steradian.open(tmp_path / "reconstruction")
    np.testing.assert_allclose(estimate_shift(series[0], series[1]).metres, 0, atol=10e-6)


def test_volume_without_an_object_is_left_by_the_alignment():
    axes = VoxelAxes(np.arange(8.0), np.arange(8.0), np.arange(8.0))
    aligner = Aligner()
    aligner.align(Volume(np.ones((8, 8, 8), np.float32), axes, (1.0,) * 3))
    empty = Volume(np.zeros((8, 8, 8), np.float32), axes, (1.0,) * 3)
    volume, report = aligner.align(empty)
    assert volume is empty
    assert report is None


def _prepared(path, change=lambda recording: recording, **options):
    recording = change(open_recording(path))
    return recording, *prepare(recording, ReconstructionParameters.create(**(FAST | options)))


def test_motion_is_refused_where_it_cannot_be_known(tmp_path):
    snake = write_scan(tmp_path / "snake.h5", still, order="snake")
    with pytest.raises(InvalidInput, match=r"an order in which a tenth of the scan sees \d+ % of the aperture"):
        correct_motion(*_prepared(snake))
    with pytest.raises(InvalidInput, match="motion is true; allowed: one frame of a scan file with the times"):
        correct_motion(*_prepared(snake, lambda recording: replace(recording, times=None)))
    with pytest.raises(InvalidInput, match="motion is true; allowed: a direct method"):
        correct_motion(*_prepared(snake, method="iterative"))
    told = run_here("reconstruct", snake, "--align", "-o", "out", cwd=tmp_path, code=2)
    assert "align is true; allowed: a series" in " ".join(told.split())


def test_mean_of_frames_has_no_times(jumping, tmp_path):
    with pytest.raises(InvalidInput, match="one frame of a scan file with the times"):
        reconstruct_series(jumping, tmp_path, ReconstructionParameters.create(**FAST), average=True, motion=True)


def test_motion_is_drawn(tmp_path):
    report = MotionReport(False, (0.0, 1.0), ((0.0, 0.0, 0.0), (1e-6, 0.0, 2e-6)), (1e-6, 2e-6, 3e-6))
    assert report.rms_m == pytest.approx((1e-6 / np.sqrt(2), 0.0, 2e-6 / np.sqrt(2)))
    draw_motion(report, tmp_path / "motion.png")
    with Image.open(tmp_path / "motion.png") as drawn:
        assert drawn.format == "PNG"


def test_unmix_command_aligns_the_volumes_and_lists_their_shifts(tmp_path):
    step, lights = (50e-6,) * 3, (750e-9, 850e-9)
    axes = VoxelAxes(*(50e-6 * np.arange(24) for _ in range(3)))
    places = np.meshgrid(axes.x, axes.y, axes.z, indexing="ij")

    def volume(number):
        square = sum((place - 0.5e-3 - 120e-6 * number) ** 2 for place in places)
        noise = 1e-3 * np.random.default_rng(number).standard_normal((24, 24, 24))
        return Volume((np.exp(-square / (2 * 90e-6**2)) + noise).astype(np.float32), axes, step, 1500.0)

    Series([SeriesFrame((n,), light) for n, light in enumerate(lights)], volume).save(tmp_path / "series.h5")
    run_here("unmix", "series.h5", "--align", "--fluence", "uniform", "-o", "so2", cwd=tmp_path)
    first, second = json.loads((tmp_path / "so2" / "report.json").read_text())["shifts"]
    assert not first["corrected"]
    assert second["metres"] == pytest.approx([120e-6] * 3, rel=0.03)
    assert (tmp_path / "so2" / "shifts.png").is_file()
