"""Inspection of A-lines: bad ones at known places in made data, and figures that closed forms give."""

import json

import numpy as np
import pytest
from PIL import Image

from steradian.core.exceptions import Cancelled, InvalidInput
from steradian.quality.signals import inspect_signals
from support.commands import run_here
from support.faulty import points, pressure, spoil, square, vessels

STEP = 8e-9
SPEED = 1500.0
SIDE = 25


def made(noise=0.03, seed=1):
    """Codes (n, 512) of balls above a grid with a pitch of 100 um; returns them and the positions."""
    rng = np.random.default_rng(seed)
    line = (np.arange(SIDE) - SIDE / 2) * 100e-6
    positions = np.stack(np.meshgrid(line, line), -1).reshape(-1, 2)
    traces = np.zeros((len(positions), 512))
    for _ in range(12):
        x, y, z = rng.uniform([-1e-3, -1e-3, 1.5e-3], [1e-3, 1e-3, 4e-3])
        distance = np.sqrt((positions[:, 0] - x) ** 2 + (positions[:, 1] - y) ** 2 + z**2)[:, None]
        behind = distance - SPEED * STEP * np.arange(512)
        traces += np.where(np.abs(behind) < 150e-6, behind / distance, 0)
    traces *= 1000 / np.abs(traces).max()
    sigma = noise * np.abs(traces).max()
    return traces + rng.normal(0, sigma, traces.shape), positions, rng, sigma


def test_inspect_signals_five_kinds_of_bad_lines_finds_them_and_no_other():
    traces, positions, rng, sigma = made()
    truth = dict(zip([40, 133, 290, 407, 560], ["dead", "noisy", "inverted", "saturated", "shifted"], strict=True))
    traces[40] = rng.normal(0, sigma, 512)
    traces[133] += rng.normal(0, 8 * sigma, 512)
    traces[290] *= -1
    traces[407] = np.clip(traces[407], -0.4 * traces[407].max(), 0.4 * traces[407].max())
    traces[560] = np.roll(traces[560], 40)
    report = inspect_signals(traces.round().astype(np.int16), STEP, positions, sound_speed=SPEED)
    assert {line.aline: line.kind for line in report.bad} == truth
    assert report.bad[-1].shift == pytest.approx(40 * STEP, abs=8 * STEP)


def test_inspect_signals_shift_below_the_lag_of_sound_is_an_outlier_among_neighbours():
    """96 ns late or early, where sound needs 94 ns between the farthest of the neighbours."""
    traces, positions, _, _ = made()
    truth = {140: 12, 233: -12, 315: 12, 410: -12}
    for aline, samples in truth.items():
        traces[aline] = np.roll(traces[aline], samples)
    report = inspect_signals(traces.round().astype(np.int16), STEP, positions, sound_speed=SPEED)
    assert {line.aline: line.kind for line in report.bad} == dict.fromkeys(truth, "shifted")
    for line in report.bad:
        assert line.shift == pytest.approx(truth[line.aline] * STEP, abs=4 * STEP)


@pytest.mark.long
def test_inspect_signals_small_shifts_among_10000_are_found_at_the_share_that_the_docs_state():
    """Shifts of 96 ns, a pitch of 70 um, points and vessels, a peak SNR of 30 dB and of 20 dB."""
    positions, found, count = square(100, 7e-3), 0, 0
    for made_of, noise in ((points, 0.03), (points, 0.1), (vessels, 0.03), (vessels, 0.1)):
        clean = pressure(positions, *made_of(np.random.default_rng(11), 7e-3))
        faulty = spoil(clean, np.random.default_rng(12), noise, 0.02, (6, 7))
        report = inspect_signals(faulty.codes, 16e-9, positions, sound_speed=SPEED)
        bad = {line.aline for line in report.bad}
        assert len(bad - set(faulty.truth)) <= 0.001 * len(positions)
        found, count = found + len(bad & set(faulty.of("shifted"))), count + len(faulty.of("shifted"))
    assert found >= 0.9 * count


def test_inspect_signals_noise_alone_flags_nothing_and_says_not_decidable():
    _, positions, rng, _ = made()
    noise = rng.normal(0, 20, (len(positions), 512)).round().astype(np.int16)
    report = inspect_signals(noise, STEP, positions)
    assert report.bad == ()
    assert not report.decidable


def test_inspect_signals_stated_time_zero_is_no_shift():
    """An A-line recorded 40 samples later, whose time zero says so, is as good as its neighbours."""
    traces, positions, _, _ = made()
    traces[300] = np.roll(traces[300], -40)
    zeros = np.zeros(len(traces))
    zeros[300] = 40 * STEP
    assert inspect_signals(traces, STEP, positions, time_zero=zeros).bad == ()


def test_inspect_signals_codes_are_counted():
    """Codes -2, 0 and 3 alone: -1, 1 and 2 are missing, and the offset is the mean."""
    codes = np.tile(np.array([-2, 0, 3, 0], np.int16), (4, 16))
    report = inspect_signals(codes, STEP, np.arange(4.0)[:, None])
    assert (report.missing_codes, report.mid_scale_offset) == (3, 0.25)
    np.testing.assert_array_equal(report.counts, [64, 0, 128, 0, 0, 64])
    assert report.edges[0] == -2.5
    np.testing.assert_allclose(report.power, np.var([-2, 0, 3, 0]), rtol=1e-6)


def test_inspect_signals_arrays_that_do_not_fit_are_refused():
    with pytest.raises(InvalidInput, match="positions"):
        inspect_signals(np.zeros((4, 64)), STEP, np.zeros((3, 2)))
    with pytest.raises(InvalidInput, match="traces"):
        inspect_signals(np.zeros((4, 8)), STEP, np.zeros((4, 2)))


def test_inspect_signals_cancelled_raises():
    traces, positions, _, _ = made()
    with pytest.raises(Cancelled):
        inspect_signals(traces, STEP, positions, cancelled=lambda: True)


@pytest.mark.long
def test_look_command_lists_the_bad_lines_of_a_recording(tmp_path):
    traces, positions, _, _ = made()
    traces[290] *= -1
    lengths = {"sampling_interval": STEP, "sound_speed": SPEED}
    np.savetxt(tmp_path / "lines.csv", traces.round(), delimiter=",")
    lengths["grid"] = {"count": [SIDE, SIDE], "interval": [100e-6, 100e-6]}
    (tmp_path / "about.json").write_text(json.dumps(lengths))
    run_here("import", "lines.csv", "scan.h5", "--description", "about.json", cwd=tmp_path)
    options = ("--json", "look.json", "--picture", "look.png", "--all-frames")
    output = run_here("look", "scan.h5", *options, cwd=tmp_path)
    report = json.loads((tmp_path / "look.json").read_text())
    assert [(line["aline"], line["kind"], line["mend"]) for line in report["bad"]] == [(290, "inverted", "sign")]
    assert (report["looked_at"], report["complete"]) == (len(positions), True)
    assert "inverted  A-line    290" in output
    assert f"frame 0: {len(positions)} A-lines" in output
    (frame,) = report["frames"]
    assert (frame["bad"], frame["power"]) == (1, pytest.approx(traces.round().var(axis=1).mean(), rel=1e-3))
    with Image.open(tmp_path / "look.png") as picture:
        assert picture.size[0] > 1000
