"""Frames that an image is made of: one, the first of a wavelength, the mean of several; never one in silence."""

import json

import numpy as np
import pytest

import steradian
from steradian import FrameChoice, InvalidInput, ScanPlan, grid_mask
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.run import reconstruct_scan
from steradian.reconstructions.shot_normalisation import ShotTreatment, normalise_shots
from steradian.reconstructions.studies.sound_speed_search import scan_sound_speed
from steradian.reconstructions.studies.what_if import compare_subset
from steradian.scans.exporting import export_scan
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from steradian.scans.frames import Frame, distinct_wavelengths
from steradian.scans.opening import open_recording
from support.alines import Aline
from support.commands import run_here

LIGHTS = (750e-9, 850e-9)
REPEATS, POINTS, SAMPLES = 3, 144, 128
MASK = grid_mask(2.4e-3, 12, 0.2e-3)
NOISE = 20.0
ABSENT = (4, 7)
"""Frame and point of the only A-line that was not measured."""


@pytest.fixture(scope="module")
def clean():
    """(points, samples) A-lines at the first wavelength and an energy of 1; twice as strong at the second."""
    x, y = MASK.positions.T
    late = np.sqrt(x**2 + y**2 + 1e-3**2) / 1500 / 20e-9
    return 8000 * np.exp(-(((np.arange(SAMPLES) - late[:, None]) / 4) ** 2))


@pytest.fixture(scope="module")
def measured(clean):
    """(frames, points, samples) whole numbers as the digitiser gave them, and (frames, points) energies."""
    random = np.random.default_rng(3)
    energies = random.uniform(0.5, 1.5, (2 * REPEATS, POINTS)).astype(np.float32)
    lights = np.repeat([1, 2], REPEATS)[:, None, None]
    ideal = clean * lights * energies[..., None] + random.normal(0, NOISE, (2 * REPEATS, POINTS, SAMPLES))
    return ideal.round().astype(np.int16), energies


@pytest.fixture(scope="module")
def scan(tmp_path_factory, measured):
    plan = ScanPlan.create(
        mask=MASK, samples=SAMPLES, sampling_interval=20e-9, frames=REPEATS, excitation=LIGHTS, order="given"
    )
    path = tmp_path_factory.mktemp("scan") / "scan.h5"
    create_scan_file(path, plan)
    traces, energies = (values.reshape(-1, *values.shape[2:]) for values in measured)
    rows = [row for row in range(len(traces)) if row != ABSENT[0] * POINTS + ABSENT[1]]
    with ScanFileWriter(path) as store:
        store.append(Aline(row, traces[row], energy=energies[row]) for row in rows)
    return path


def fit_of(measured, frames):
    """(points, samples) A-lines of energy 1 that fit each point's own ones best, which have equal noise."""
    traces, energies = measured
    there = np.ones((2 * REPEATS, POINTS), bool)
    there[ABSENT] = False
    energies = np.where(there, energies, 0.0)
    total = sum(energies[f, :, None] * traces[f] for f in frames)
    return total / (energies[frames] ** 2).sum(axis=0)[:, None]


@pytest.mark.parametrize(("wavelength", "frames"), [(LIGHTS[0], [0, 1, 2]), (LIGHTS[1], [3, 4, 5])])
def test_average_of_a_wavelength_is_the_least_squares_mean_of_its_repetitions(scan, measured, wavelength, frames):
    recording = open_recording(scan, FrameChoice(wavelength=wavelength, average=True))
    even, _ = normalise_shots(recording, ShotTreatment())
    np.testing.assert_allclose(even.positions, MASK.positions, atol=1e-9)
    values = even.traces * np.asarray(even.scale)
    np.testing.assert_allclose(values, fit_of(measured, frames), rtol=1e-5, atol=1e-2)
    np.testing.assert_allclose(even.weights, MASK.weights, rtol=1e-6)
    assert recording.notes == ()


def test_average_of_three_repetitions_has_the_noise_of_the_sum_of_squared_energies(scan, clean, measured):
    even, _ = normalise_shots(open_recording(scan, FrameChoice(wavelength=LIGHTS[0], average=True)), ShotTreatment())
    noise = even.traces * np.broadcast_to(even.scale, POINTS)[:, None] - clean
    expected = NOISE / np.sqrt((measured[1][:REPEATS].astype(float) ** 2).sum(axis=0))
    np.testing.assert_allclose(np.std(noise / expected[:, None]), 1.0, rtol=0.03)


def test_average_leaves_out_a_flagged_repetition_of_a_point_and_no_other(tmp_path):
    plan = ScanPlan.create(mask=MASK, samples=SAMPLES, frames=2, order="given")
    create_scan_file(tmp_path / "a.h5", plan)
    with ScanFileWriter(tmp_path / "a.h5") as store:
        lines = [Aline(row, np.full(SAMPLES, 100 if row < POINTS else 300, np.int16)) for row in range(2 * POINTS)]
        lines[5].quality = 1  # saturated
        store.append(lines)
    even, found = normalise_shots(open_recording(tmp_path / "a.h5", FrameChoice(average=True)), ShotTreatment())
    expected = np.full(POINTS, 200.0)
    expected[5] = 300
    np.testing.assert_allclose(even.traces[:, 0] * np.asarray(even.scale), expected, rtol=1e-6)
    np.testing.assert_allclose(even.weights, MASK.weights, rtol=1e-6)
    assert found.left_out == {"saturated": 1}


def brightest(scan, choice, tmp_path):
    report = reconstruct_scan(scan, tmp_path, ReconstructionParameters.create(modes=24), frame=choice)
    return report, steradian.open(tmp_path / "volume.h5").values.max()


def test_image_of_a_wavelength_is_as_bright_as_its_light_and_names_the_frames(scan, tmp_path):
    first, one = brightest(scan, FrameChoice(wavelength=LIGHTS[0], average=True), tmp_path / "1")
    second, two = brightest(scan, FrameChoice(wavelength=LIGHTS[1], average=True), tmp_path / "2")
    assert two / one == pytest.approx(2, rel=0.01)
    assert first.notes == []
    assert (first.provenance["frame"], first.provenance["excitation"]) == ("0, 1, 2 of 6", "750 nm")
    assert (second.provenance["frame"], second.provenance["excitation"]) == ("3, 4, 5 of 6", "850 nm")
    assert (first.sensors, first.planned) == (POINTS, POINTS)


@pytest.mark.parametrize(("choice", "number", "light"), [({}, 0, "750"), ({"wavelength": 850e-9}, 3, "850")])
def test_image_of_default_frame_notes_frame_number(scan, tmp_path, choice, number, light):
    report, _ = brightest(scan, FrameChoice(**choice), tmp_path)
    assert len(report.notes) == 1
    assert f"made of frame {number} of 6 (0 to 5, {light} nm)" in report.notes[0]
    assert json.loads((tmp_path / "report.json").read_text())["notes"] == report.notes


@pytest.mark.long
def test_sound_speed_and_subset_reports_note_frame_number(scan, tmp_path):
    curve = scan_sound_speed(scan, tmp_path, first=1450, last=1550, steps=3)
    report = compare_subset(scan, MASK, tmp_path, ReconstructionParameters.create(modes=24))
    for notes in (curve.notes, report.notes):
        assert "frame 0 of 6" in notes[0]
    assert "frame 0 of 6" in json.loads((tmp_path / "sound-speed.json").read_text())["notes"][0]


@pytest.mark.parametrize(
    ("choice", "words"),
    [
        ({"frame": 6}, "frame is 6; allowed: a whole number, 0 to 5"),
        ({"frame": 1, "average": True}, "frame is 1; allowed: neither wavelength nor average with it"),
        ({"wavelength": 800e-9}, "wavelength is 800 nm; allowed: one that the scan was measured at: 750 nm, 850 nm"),
        ({"average": True}, "average is true; allowed: with one wavelength of several: 750 nm, 850 nm"),
    ],
)
def test_invalid_frame_choice_is_refused_with_available_frames(scan, choice, words):
    with pytest.raises(InvalidInput, match=words):
        open_recording(scan, FrameChoice(**choice))


def test_wavelengths_that_differ_by_rounding_are_one():
    frames = [Frame(n, light, 1) for n, light in enumerate((750e-9, 750.0000001e-9, 749.9e-9, 751e-9))]
    assert distinct_wavelengths(frames) == [750e-9, 751e-9]
    assert FrameChoice(average=True).pick(frames[:3]) == ([0, 1, 2], ())
    assert FrameChoice(wavelength=750e-9, average=True).pick(frames) == ([0, 1, 2], ())


def test_library_asks_for_a_frame_of_several(scan):
    with pytest.raises(InvalidInput, match="frame is None; allowed: a whole number, 0 to 5"):
        steradian.open(scan).reconstruct()
    mean = steradian.open(scan).reconstruct(frame=FrameChoice(wavelength=LIGHTS[1], average=True), modes=24)
    one = steradian.open(scan).reconstruct(frame=3, modes=24)
    assert mean.values.max() == pytest.approx(one.values.max(), rel=0.02)


@pytest.mark.long
def test_reconstruct_command_makes_a_series_of_all_frames_or_of_means(scan, tmp_path):
    out = run_here("reconstruct", scan, "--modes", 24, "-o", "all", cwd=tmp_path)
    assert "3 at 750 nm, 3 at 850 nm" in " ".join(out.split())
    assert len(steradian.open(tmp_path / "all")) == 6
    run_here("reconstruct", scan, "--modes", 24, "--average", "-o", "means", cwd=tmp_path)
    values = [volume.values.max() for volume in steradian.open(tmp_path / "means")]
    assert values[1] / values[0] == pytest.approx(2, rel=0.01)
    run_here("reconstruct", scan, "--modes", 24, "--frame", 1, "-o", "one", cwd=tmp_path)
    assert (tmp_path / "one" / "volume.h5").is_file()


@pytest.mark.long
def test_reconstruct_command_takes_frames_of_a_file_that_is_not_imported(scan, tmp_path):
    """The file is imported beside the image first, with its pulse energies, which differ by half."""
    export_scan(scan, tmp_path / "lab.hdf5", format="ipasc")
    run_here("reconstruct", "lab.hdf5", "--modes", 24, "--average", "-o", "all", cwd=tmp_path)
    values = [volume.values.max() for volume in steradian.open(tmp_path / "all")]
    assert values[1] / values[0] == pytest.approx(2, rel=0.01)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--wavelength", "800nm"], "wavelength is 800 nm; allowed: one that the scan was measured at: 750 nm, 850 nm"),
        (["--follow", "--average"], "follow is true; allowed: without frame, wavelength and average"),
    ],
)
def test_reconstruct_command_refuses_choices_that_exclude_each_other(scan, tmp_path, words, told):
    out = run_here("reconstruct", scan, *words, cwd=tmp_path, code=2)
    assert told in " ".join(out.split())
    assert not (tmp_path / "reconstruction").exists()


def test_reconstruct_command_refuses_choices_that_exclude_each_other_before_it_imports(tmp_path):
    words = ["--frame", "1", "--average", "-d", '{"sound_speed": 1500}']
    out = run_here("reconstruct", "absent.npy", *words, cwd=tmp_path, code=2)
    assert "frame is 1; allowed: neither wavelength nor average with it" in " ".join(out.split())
    assert not (tmp_path / "reconstruction").exists()
