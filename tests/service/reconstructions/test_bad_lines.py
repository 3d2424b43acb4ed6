"""Bad A-lines left out or mended: against made A-lines whose faults, and whose image without them, are known."""

import json
from dataclasses import replace

import numpy as np
import pytest

from steradian.core.exceptions import Cancelled, InvalidInput
from steradian.imaging.geometry import polygons as outlines
from steradian.imaging.geometry.sensor_areas import sensed_region
from steradian.jobs.reconstruction_request import ReconstructionRequest
from steradian.masks import equi_steradian_mask
from steradian.quality import correlation
from steradian.quality.signals import inspect_signals
from steradian.reconstructions.live.follow import reconstruct_live
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.report import Report
from steradian.reconstructions.pipeline.run import reconstruct_and_write, reconstruct_in_memory
from steradian.reconstructions.shot_normalisation import ShotTreatment, normalise_shots
from steradian.scans.recording import Recording, ShotMetadata
from support.commands import run_here
from support.faulty import KINDS, SPEED, STEP, points, pressure, spoil, square, vessels

APERTURE = 7e-3


def recording(codes, positions, **about):
    """A recording of these A-lines, each with an equal weight."""
    count, shots = len(codes), ShotMetadata.default(np.zeros(len(codes)))
    outline = sensed_region(positions, APERTURE)
    weights = np.full(count, outlines.area(outline) / count)
    said = {"grid": None, "depth": None, "planned": count, "provenance": {}, "shots": shots, "outline": outline} | about
    return Recording(codes, 1.0, positions, weights, STEP, SPEED, APERTURE, 0.0, **said)


@pytest.fixture(scope="module")
def small():
    """900 A-lines with two of each fault, and their positions."""
    rng, positions = np.random.default_rng(3), square(30, 2e-3)
    return spoil(pressure(positions, *points(rng, 2e-3, 12)), rng, 0.02, 0.011), positions


def even(small, treatment, **about):
    faulty, positions = small
    return normalise_shots(recording(faulty.codes, positions, **about), ShotTreatment(bad_lines=treatment))


def test_even_out_without_a_request_keeps_bad_lines(small):
    faulty, positions = small
    found, told = normalise_shots(recording(faulty.codes, positions), ShotTreatment())
    np.testing.assert_array_equal(found.traces, faulty.codes)
    assert (told.bad_lines, found.notes) == (None, ())


def test_even_out_leave_out_removes_all_kinds_and_preserves_area(small):
    faulty, positions = small
    found, told = even(small, "leave-out")
    good = np.delete(np.arange(len(positions)), list(faulty.truth))
    np.testing.assert_array_equal(found.positions, positions[good])
    np.testing.assert_array_equal(found.traces, faulty.codes[good])
    assert found.weights.sum() == pytest.approx(recording(faulty.codes, positions).weights.sum())
    assert told.bad_lines.left_out == dict.fromkeys(KINDS, 2)
    assert {kind: told.bad_lines.rows[kind] for kind in KINDS} == {kind: faulty.of(kind) for kind in KINDS}
    assert found.notes[0].startswith("left out 10 of 900 A-lines: ")


def test_even_out_mend_restores_inverted_and_shifted_lines(small):
    """Restored to the true A-line but for its noise, 2 % of the peak, and what a shift pushed out of the record."""
    faulty, positions = small
    found, told = even(small, "mend")
    rows = np.delete(np.arange(len(positions)), [n for kind in ("dead", "noisy", "saturated") for n in faulty.of(kind)])
    np.testing.assert_array_equal(found.positions, positions[rows])
    assert told.bad_lines.mended == {"inverted": 2, "shifted": 2}
    for aline in faulty.of("inverted") + faulty.of("shifted"):
        mended = found.traces[np.flatnonzero(rows == aline)[0]][60:-60]
        assert np.corrcoef(mended, faulty.clean[aline][60:-60])[0, 1] > 0.8
    assert "mended 4 of 900 A-lines: " in found.notes[0]


def test_even_out_bad_lines_of_an_evened_recording_are_not_sought_again(small):
    found, _ = even(small, "leave-out")
    again, told = normalise_shots(found, ShotTreatment(bad_lines="leave-out"))
    assert again is found
    assert told.bad_lines is None


def test_even_out_bad_lines_without_shots_are_treated_and_the_voxels_stay(small):
    """A foreign file whose sensors fill a grid."""
    found, told = even(small, "leave-out", shots=None, grid=30)
    assert (len(found.traces), found.grid, sum(told.bad_lines.left_out.values())) == (890, 30, 10)


def test_even_out_bad_lines_of_averaged_frames_are_found_in_each_frame(small):
    """Frame 2 of a scan is clean and frame 5 is not: rows are those of the file."""
    faulty, positions = small
    count = len(positions)
    both = recording(
        np.concatenate([faulty.clean, faulty.codes]),
        np.concatenate([positions] * 2),
        planned=count,
        points=np.tile(np.arange(count), 2),
        rows=np.concatenate([np.arange(count) + 2 * count, np.arange(count) + 5 * count]),
    )
    found, told = normalise_shots(both, ShotTreatment(bad_lines="leave-out"))
    assert told.bad_lines.rows["dead"] == [aline + 5 * count for aline in faulty.of("dead")]
    assert len(found.traces) == count, "every point has its A-line of the other frame"
    np.testing.assert_array_equal(found.traces[faulty.of("dead")], faulty.clean[faulty.of("dead")])


def test_even_out_bad_lines_at_unlike_gain_are_no_noisy_ones(small):
    """Every other A-line was received at twice the gain, which its scale makes up for."""
    faulty, positions = small
    gain = np.where(np.arange(len(positions)) % 7 < 2, 3, 1)
    found = replace(recording(faulty.clean * gain[:, None].astype(np.int16), positions), scale=1 / gain)
    assert normalise_shots(found, ShotTreatment(bad_lines="leave-out"))[1].bad_lines.left_out == {}


def test_even_out_bad_lines_can_be_cancelled(small):
    faulty, positions = small
    with pytest.raises(Cancelled):
        normalise_shots(recording(faulty.codes, positions), ShotTreatment(bad_lines="mend"), cancelled=lambda: True)


def test_follow_with_bad_lines_is_refused(tmp_path):
    parameters = ReconstructionParameters.create(shots={"bad_lines": "mend"})
    with pytest.raises(InvalidInput, match=r"shots\.bad_lines.*mend.*keep"):
        reconstruct_live(tmp_path / "scan.h5", tmp_path, parameters, is_over=lambda: True)
    with pytest.raises(InvalidInput, match=r"shots\.bad_lines.*mend.*keep"):
        ReconstructionRequest.create(scan_id="s01jz0000000000000000000000", parameters=parameters, follow=True)


@pytest.mark.long
def test_write_reconstruction_bad_lines_stand_in_report_and_notes(small, tmp_path):
    faulty, positions = small
    parameters = ReconstructionParameters.create(modes=30, shots={"bad_lines": "mend"})
    reconstruct_and_write(recording(faulty.codes, positions), tmp_path, parameters, Report())
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["sensors"] == 894
    assert report["shots"]["bad_lines"]["rows"]["shifted"] == faulty.of("shifted")
    assert [note for note in report["notes"] if "left out 6 of 900 A-lines" in note]


@pytest.mark.long
def test_reconstruct_command_leaves_bad_lines_out(small, tmp_path):
    faulty, _ = small
    np.savetxt(tmp_path / "lines.csv", faulty.codes, delimiter=",", fmt="%d")
    about = {"sampling_interval": STEP, "sound_speed": SPEED}
    about["grid"] = {"count": [30, 30], "interval": [2e-3 / 30, 2e-3 / 30]}
    (tmp_path / "about.json").write_text(json.dumps(about))
    run_here("import", "lines.csv", "scan.h5", "--description", "about.json", cwd=tmp_path)
    output = run_here("reconstruct", "scan.h5", "-o", "out", "--bad-lines", "leave-out", "--modes", "30", cwd=tmp_path)
    assert "left out 10 of 900 A-lines" in " ".join(output.split())
    assert json.loads((tmp_path / "out" / "report.json").read_text())["sensors"] == 890


SCANS = [
    (1, "grid", points, 0.1),
    (2, "grid", vessels, 0.03),
    (3, "grid", vessels, 0.1),
    (4, "equi-steradian", points, 0.03),
    (5, "equi-steradian", vessels, 0.1),
]
"""Seed, mask, object and noise of simulated scans; CI tries one of each mask and of each object."""


@pytest.mark.parametrize(
    "scans",
    [
        pytest.param(SCANS[2:4], marks=pytest.mark.long, id="two"),
        pytest.param(SCANS, marks=pytest.mark.nightly, id="all"),
    ],
)
def test_bad_lines_of_20000_are_found_and_the_image_is_that_of_clean_lines(scans):
    """1 % of five kinds; a peak SNR of 30 dB and of 20 dB; points and vessels, a grid and an equi-steradian mask.

    99 % of all are found, at most 0.1 % of any scan falsely, and both treatments give an image whose correlation with
    that of the same A-lines without faults is within 0.005 of 1, where the faults alone cost more.
    """
    masks = {"grid": square(141, APERTURE), "equi-steradian": equi_steradian_mask(APERTURE, 3e-3, 20_000).positions}
    found = spoilt = 0
    worst = {"keep": 1.0, "leave-out": 1.0, "mend": 1.0}
    for seed, mask, made, noise in scans:
        rng, positions = np.random.default_rng(seed), masks[mask]
        faulty = spoil(pressure(positions, *made(rng, APERTURE)), rng, noise)
        report = inspect_signals(faulty.codes, STEP, positions, sound_speed=SPEED)
        bad = {line.aline for line in report.bad}
        assert report.decidable
        assert len(bad - set(faulty.truth)) <= 0.001 * len(positions)
        found, spoilt = found + len(bad & set(faulty.truth)), spoilt + len(faulty.truth)
        clean = _image(faulty.clean, positions, "keep")
        for treatment, least in worst.items():
            worst[treatment] = min(least, correlation(_image(faulty.codes, positions, treatment), clean))
    assert found >= 0.99 * spoilt
    assert worst["leave-out"] >= 0.995
    assert worst["mend"] >= 0.995
    assert worst["keep"] < min(worst["leave-out"], worst["mend"])


def _image(codes, positions, treatment):
    parameters = ReconstructionParameters.create(modes=128, shots={"bad_lines": treatment}, depth_range=(1e-3, 5e-3))
    return reconstruct_in_memory(recording(codes, positions), parameters).values
