"""Recordings of other programs become scans like any other."""

import dataclasses
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
import foreign

from steradian.core.exceptions import Cancelled, Conflict, DamagedFile, InvalidInput, NotFound
from steradian.reconstructions.shot_normalisation import ShotTreatment, normalise_shots
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from steradian.scans.importing import import_scan
from steradian.scans.importing.inspect import inspect_recording
from steradian.scans.opening import open_recording

NO_OCTAVE = "needs Octave: apt-get install octave (or dnf, brew install octave)"


@pytest.fixture
def scan(tmp_path):
    return tmp_path / "imported" / "scan.h5"


@pytest.mark.parametrize("write", foreign.WRITERS, ids=lambda write: write.__name__)
def test_every_format_keeps_axes_pitches_and_samples(tmp_path, scan, write):
    """The A-lines are the ball's pressure at the imported positions, and these have the grid's pitches in order."""
    found = write(tmp_path)
    if found is None:
        pytest.skip(NO_OCTAVE)
    source, description = found
    summary = import_scan(source, scan, description=description)
    assert (summary.points, summary.samples) == (len(foreign.grid()), foreign.SAMPLES)
    recording = open_recording(scan)
    np.testing.assert_allclose(recording.traces, foreign.expected(recording.positions), atol=2e-5)
    assert len(np.unique(recording.positions.round(9), axis=0)) == len(foreign.grid())
    for axis, (count, pitch) in enumerate(zip(foreign.COUNTS, foreign.PITCH, strict=True)):
        levels = np.unique(recording.positions[:, axis].round(9))
        assert len(levels) == count
        np.testing.assert_allclose(np.diff(levels), pitch, rtol=1e-5)
    assert recording.aperture == pytest.approx(2.4e-3)
    assert recording.sampling_interval == pytest.approx(foreign.DT)
    assert recording.sound_speed == pytest.approx(foreign.SPEED)
    np.testing.assert_allclose(recording.weights, 2.4e-3**2 / len(foreign.grid()))


def test_an_imported_scan_gives_the_image_of_its_ball(tmp_path, scan):
    """The ball of an imported recording is reconstructed where it is, in x, y and depth."""
    from steradian.reconstructions.parameters import ReconstructionParameters
    from steradian.reconstructions.pipeline.run import reconstruct_in_memory

    source, description = foreign.matlab_positions(tmp_path)
    import_scan(source, scan, description=description)
    volume = reconstruct_in_memory(open_recording(scan), ReconstructionParameters.create(modes=24))
    peak = np.unravel_index(volume.values.argmax(), volume.values.shape)
    place = [volume.coordinates(axis)[index] for axis, index in zip("xyz", peak, strict=True)]
    np.testing.assert_allclose(place, foreign.BALL.centres[0], atol=0.15e-3)


@pytest.mark.parametrize("write", [foreign.matlab_positions, foreign.ipasc_by_pacfish, foreign.npz_with_positions])
def test_a_foreign_file_is_read_in_place_as_it_is_imported(tmp_path, scan, write):
    """Reconstructing a foreign file needs no import first: the same A-lines at the same places."""
    source, _ = write(tmp_path)
    import_scan(source, scan)
    direct, imported = open_recording(source), open_recording(scan)
    np.testing.assert_array_equal(direct.traces.astype(np.float32), imported.traces)
    np.testing.assert_array_equal(direct.positions, imported.positions)


@pytest.mark.parametrize(
    ("kind", "stored"), [("<i2", "<i2"), (">i2", "<i2"), ("<f4", "<f4"), ("<u1", "<i2"), ("<i4", "<f4")]
)
def test_import_keeps_sample_type_and_values_exactly(tmp_path, scan, kind, stored):
    """Digitiser counts stay counts, floats stay floats; nothing is rounded."""
    values = np.random.default_rng(3).integers(0, 256, (6, 32)).astype(kind) * np.dtype(kind).type(
        0.5 if "f" in kind else 1
    )
    np.save(tmp_path / "a.npy", values)
    about = foreign.describe(
        tmp_path, sampling_interval=1e-8, sound_speed=1500, grid={"count": [2, 3], "interval": [1e-4, 1e-4]}
    )
    import_scan(tmp_path / "a.npy", scan, description=about)
    with h5py.File(scan) as file:
        assert file["alines/samples"].dtype == np.dtype(stored)
    np.testing.assert_array_equal(open_recording(scan).traces, values)


def test_wavelengths_and_frames_become_frames(tmp_path, scan):
    """All frames of a multi-wavelength file are kept, each under its wavelength; a description can choose one."""
    source, _ = foreign.ipasc_by_pacfish(tmp_path, wavelengths=3, frames=2)
    summary = import_scan(source, scan)
    points, truth = len(foreign.grid()), foreign.expected(foreign.grid())
    assert summary.points == 6 * points
    with h5py.File(scan) as file:
        np.testing.assert_allclose(file["plan/frame_excitation"], np.repeat([700e-9, 800e-9, 900e-9], 2))
        for frame, factor in enumerate([1, 11, 2, 12, 3, 13]):
            rows = file["alines/samples"][frame * points : (frame + 1) * points]
            np.testing.assert_allclose(rows, factor * truth, atol=1e-5)
    chosen = scan.with_name("chosen.h5")
    import_scan(source, chosen, description=foreign.describe(tmp_path, wavelength=2, frame=1))
    np.testing.assert_allclose(open_recording(chosen).traces, 13 * truth, atol=1e-5)


def contents(path):
    """Bytes of all data sets and attributes by name; the file's own bytes tell when it was made, too."""
    found = {}

    def note(name, item):
        found.update({f"{name}@{key}": np.asarray(value).tobytes() for key, value in item.attrs.items()})
        if isinstance(item, h5py.Dataset):
            found[name] = (item.dtype, item.shape, item[()].tobytes())

    with h5py.File(path) as file:
        note("/", file)
        file.visititems(note)
    return found


def test_an_own_scan_is_copied_once_it_is_checked(tmp_path, scan, plan, alines):
    """An own file, complete or not, arrives bit for bit; a flipped bit in an A-line is refused, naming which."""
    create_scan_file(tmp_path / "own.h5", plan)
    with ScanFileWriter(tmp_path / "own.h5") as store:
        store.append(alines[:20])
    assert import_scan(tmp_path / "own.h5", scan).points == 20
    assert contents(scan) == contents(tmp_path / "own.h5")
    with h5py.File(tmp_path / "own.h5", "r+") as file:
        row = int(np.flatnonzero(file["alines/status"])[4])
        file["alines/samples"][row, 7] ^= 1
    with pytest.raises(DamagedFile, match=f"A-line {row} "):
        import_scan(tmp_path / "own.h5", tmp_path / "copy.h5")


def test_time_zero_comes_from_the_description_and_from_late_kwave_recordings(tmp_path, scan):
    """The time of the first sample is kept: stated, or the steps that k-Wave did not record."""
    source, _ = foreign.npy_time_first(tmp_path)
    about = {"sampling_interval": 20, "times": "ns", "sound_speed": 1480, "axes": "time, point", "time_zero": 300}
    grid = {"count": foreign.COUNTS, "interval": foreign.PITCH}
    import_scan(source, scan, description=foreign.describe(tmp_path, grid=grid, **about))
    assert open_recording(scan).time_zero == pytest.approx(300e-9)
    source, description = foreign.kwave_index_mask(tmp_path)
    with h5py.File(source, "r+") as file:
        file["Nt"][...] = foreign.SAMPLES + 25
    import_scan(source, scan.with_name("late.h5"), description=description)
    assert open_recording(scan.with_name("late.h5")).time_zero == pytest.approx(25 * foreign.DT)


def test_import_centres_sensor_positions_and_records_shift(tmp_path, scan):
    """The mask says which of the file's axes became x and y, and where its own origin lay."""
    import json

    source, _ = foreign.ipasc_by_pacfish(tmp_path)
    import_scan(source, scan)
    with h5py.File(scan) as file:
        arrangement = json.loads(file["mask"].attrs["arrangement"])
    assert arrangement["axes"] == ["x", "y"]
    np.testing.assert_allclose(arrangement["centre_m"], [5e-3, 7e-3])


def test_progress_counts_alines_and_a_stop_leaves_nothing(tmp_path, scan, monkeypatch):
    """Progress rises to the whole; a cancelled import removes everything it wrote and can be repeated."""
    monkeypatch.setattr("steradian.scans.importing.aline_blocks.BLOCK_BYTES", 16 * foreign.SAMPLES * 4)
    source, description = foreign.npy_time_first(tmp_path)
    seen = []
    stop = iter([False, False, True])
    with pytest.raises(Cancelled):
        import_scan(source, scan, description=description, cancelled=lambda: next(stop))
    assert list(scan.parent.iterdir()) == []
    import_scan(source, scan, description=description, progress=lambda *told: seen.append(told))
    assert [done for _, done, _ in seen] == list(range(16, 97, 16))
    assert {(stage, total) for stage, _, total in seen} == {("A-lines", 96)}
    assert list(scan.parent.iterdir()) == [scan]
    with pytest.raises(Conflict):
        import_scan(source, scan, description=description)


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"sampling_interval": None}, InvalidInput, "sampling_interval"),
        ({"sound_speed": None}, InvalidInput, "sound_speed"),
        ({"sound_speed": 15}, InvalidInput, "300"),
        ({"grid": None}, InvalidInput, "positions"),
        ({"grid": {"count": [12, 9], "interval": [1e-4, 1e-4]}}, InvalidInput, "108 positions"),
        ({"grid": {"count": [10**9, 10**9], "interval": [1e-4, 1e-4]}}, InvalidInput, "grid.count"),
        ({"grid": None, "positions": "../secret.csv"}, InvalidInput, "bare name"),
        ({"grid": None, "positions": "/etc/passwd"}, InvalidInput, "bare name"),
        ({"grid": None, "positions": "none.csv"}, NotFound, "none.csv"),
        ({"aperture": 1e-3}, InvalidInput, "within the aperture"),
        ({"speed": 1500}, InvalidInput, "only the fields"),
        ({"scale": float("nan")}, InvalidInput, "scale"),
        ({"axes": "point, time"}, InvalidInput, "96 positions"),
    ],
)
def test_a_description_that_does_not_fit_is_refused_by_name(tmp_path, scan, change, error, words):
    """What is missing, unknown, out of range or contradicting is named, and no file is made."""
    source, _ = foreign.npy_time_first(tmp_path)
    about = {"sampling_interval": foreign.DT, "sound_speed": 1480.0, "axes": "time, point"}
    about["grid"] = {"count": foreign.COUNTS, "interval": foreign.PITCH}
    fields = {name: value for name, value in (about | change).items() if value is not None}
    with pytest.raises(error, match=words):
        import_scan(source, scan, description=foreign.describe(tmp_path, **fields))
    assert not scan.exists()


MM = (1e3 * foreign.grid()).tolist()


@pytest.mark.parametrize(
    ("about", "field", "words"),
    [
        ({"positions": MM}, "positions", 'sensors over 2.2 m; .*in m; it may say "lengths": "mm" or "um"'),
        ({"positions": MM, "lengths": "um", "aperture": 2e6}, "aperture", 'aperture is 2e.06 um; .*"m" or "mm"'),
        ({"grid": {"count": [12, 8], "interval": [0.2, 0.3]}}, "grid.interval", 'sensors over 2.2 m; .*"lengths"'),
        ({"positions": MM, "lengths": "mm", "times": "s"}, "sampling_interval", 'is 20 s; .*"times": "us" or "ns"'),
    ],
)
def test_numbers_in_another_unit_are_named_as_they_were_given(tmp_path, scan, about, field, words):
    """Millimetres for metres: the message names the positions, not an aperture that nobody gave, and the way out."""
    np.save(tmp_path / "a.npy", foreign.expected(foreign.grid()))
    base = {"sampling_interval": 20, "times": "ns", "sound_speed": 1480}
    with pytest.raises(InvalidInput, match=words) as refusal:
        import_scan(tmp_path / "a.npy", scan, description=foreign.describe(tmp_path, **(base | about)))
    assert refusal.value.field == field


def test_numbers_of_a_file_in_another_unit_are_named_too(tmp_path, scan):
    """A file's own positions are in metres, whatever a description says of its own numbers."""
    np.savez(tmp_path / "a.npz", traces=foreign.expected(foreign.grid()), positions=MM, dt=2e-8, c=1480.0)
    with pytest.raises(InvalidInput, match=r"positions is sensors over 2\.2 m; .*numbers of a file count as m"):
        import_scan(tmp_path / "a.npz", scan)


def test_the_formats_page_lists_every_name_that_is_understood(tmp_path):
    """Names in the page's table are those of the code, in the order in which they are looked for."""
    import re

    from steradian.scans.importing import numpy_files, variable_aliases

    page = (Path(__file__).parents[3] / "docs" / "formats.md").read_text()
    rows = re.findall(r"^\| ([^|]+) \| ((?:`[^`|]+`,? ?)+)\|", page.split("### Names")[1], re.MULTILINE)
    told = {what.split(" (")[0]: tuple(re.findall("`([^`]+)`", row)) for what, row in rows}
    assert told == {
        "A-lines": numpy_files.TRACES,
        "time between samples": variable_aliases.INTERVAL,
        "samples a second": variable_aliases.RATE,
        "speed of sound": variable_aliases.SPEED,
        "time of the first sample": variable_aliases.TIME_ZERO,
        "pulse energies, of each A-line, sensor or frame, in any unit": variable_aliases.ENERGIES,
        "positions": variable_aliases.POSITIONS,
        "mask": variable_aliases.MASK,
        "areas": variable_aliases.WEIGHTS,
        "side of the aperture": variable_aliases.APERTURE,
        "distance of the point of interest": variable_aliases.DEPTH,
        "pitches along x, y, z": (*variable_aliases.STEPS, *variable_aliases.KGRID),
        "pitch along x of `p` in an archive": variable_aliases.LATERAL_STEPS[0],
        "pitch along y of `p` in an archive": variable_aliases.LATERAL_STEPS[1],
    }


def test_a_line_of_sensors_becomes_a_scan_of_a_line(tmp_path, scan):
    """A 2-D k-Wave archive (time, y) has positions (M, 1), lengths for weights, and gives an image."""
    traces = np.random.default_rng(4).normal(size=(64, 30)).astype("f4")
    traces[:8] = 0  # no sound has arrived yet
    np.savez(tmp_path / "line.npz", p=traces, dt=2e-8, dx=1e-4, c=1500.0)
    assert import_scan(tmp_path / "line.npz", scan).points == 30
    recording = open_recording(scan)
    np.testing.assert_allclose(recording.positions, 1e-4 * (np.arange(30) - 15)[:, None], atol=1e-12)
    np.testing.assert_array_equal(recording.traces, traces.T)
    assert recording.weights.sum() == pytest.approx(3e-3)


@pytest.mark.parametrize(
    ("steps", "pitches"),
    [
        ({"dx": 5e-5, "dy": 1e-4, "dz": 2e-4}, (1e-4, 2e-4)),
        ({"dx": 5e-5, "dy": 1e-4}, (1e-4, 1e-4)),
        ({"dx": 1e-4}, (1e-4, 1e-4)),
    ],
)
def test_import_of_kwave_pressure_uses_lateral_axis_pitches(tmp_path, scan, steps, pitches):
    """Of k-Wave's p (time, y, z) the axes are y and z: dx is its step in depth, and counts only for want of others."""
    np.savez(tmp_path / "p.npz", p=np.ones((64, 6, 5), "f4"), dt=2e-8, c=1500.0, **steps)
    import_scan(tmp_path / "p.npz", scan)
    positions = open_recording(scan).positions
    for axis, (count, pitch) in enumerate(zip((6, 5), pitches, strict=True)):
        np.testing.assert_allclose(np.unique(positions[:, axis].round(9)), pitch * (np.arange(count) - count // 2))


@pytest.mark.parametrize("scale", [1.0, 1 / 96], ids=["ones", "sum of 1"])
def test_import_of_relative_weights_scales_them_to_sensor_area(tmp_path, scan, scale):
    """Weights too large for areas say only how sensors compare; areas stay as they are."""
    points = foreign.grid()
    relative = scale * np.where(points[:, 0] > 0, 1.0, 0.5)
    arrays = {"traces": foreign.expected(points), "positions": points, "dt": foreign.DT, "c": 1480.0}
    np.savez(tmp_path / "a.npz", weights=relative, **arrays)
    import_scan(tmp_path / "a.npz", scan)
    weights = open_recording(scan).weights
    assert weights.sum() == pytest.approx(2.4e-3**2)
    np.testing.assert_allclose(weights / weights.sum(), relative / relative.sum())
    areas = 2e-8 * relative / scale
    np.savez(tmp_path / "b.npz", weights=areas, **arrays)
    import_scan(tmp_path / "b.npz", scan.with_name("b.h5"))
    np.testing.assert_allclose(open_recording(scan.with_name("b.h5")).weights, areas)


@pytest.mark.parametrize(
    ("name", "field", "stated"),
    [
        ("c0", "sound_speed", {"sound_speed": 1480.0}),
        ("dt", "sampling_interval", {"sampling_interval": foreign.DT}),
        ("t0", "time_zero", {"time_zero": 0.0}),
        ("depth", None, {"depth": 3e-3}),
    ],
)
def test_an_array_under_a_numbers_name_is_no_hindrance_once_the_number_is_stated(tmp_path, scan, name, field, stated):
    """A map of the speed of sound beside the A-lines is none of the numbers; the description gives what is missing."""
    points = foreign.grid()
    arrays = {"traces": foreign.expected(points), "positions": points, "dt": foreign.DT, "c": 1480.0}
    arrays = {key: value for key, value in arrays.items() if (key, name) not in {("c", "c0")}}
    np.savez(tmp_path / "a.npz", **(arrays | {name: np.full((4, 5, 6), 1500.0)}))
    if field is not None:
        with pytest.raises(InvalidInput) as refusal:
            import_scan(tmp_path / "a.npz", scan)
        assert refusal.value.field == field
    assert import_scan(tmp_path / "a.npz", scan, description=foreign.describe(tmp_path, **stated)).points == 96


def _npz(path, **arrays):
    np.savez(path.with_suffix(".npz"), **arrays)
    return path.with_suffix(".npz")


def _mat5(path, **arrays):
    from scipy.io import savemat

    savemat(path.with_suffix(".mat"), arrays)
    return path.with_suffix(".mat")


def _mat7(path, **arrays):
    return foreign._matlab(path.with_suffix(".mat"), **arrays)


@pytest.mark.parametrize("write", [_npz, _mat5, _mat7])
def test_each_sensor_may_have_its_own_time_zero(tmp_path, scan, write):
    """Once in the scan file and once read from where it came; an array that is none of them is refused by its name."""
    points = foreign.grid()
    zeros = 1e-8 * np.arange(len(points))
    grid = {"sensor_data": foreign.expected(points).reshape(*foreign.COUNTS, -1), "dx": foreign.PITCH[0]}
    listed = {"sensor_data": foreign.expected(points), "positions": points}
    for number, (arrays, each) in enumerate([(listed, zeros), (grid, zeros.reshape(foreign.COUNTS))]):
        arrays = arrays | {"dt": foreign.DT, "c": 1480.0, "dy": foreign.PITCH[1]}
        source, made = write(tmp_path / f"a{number}", t0=each, **arrays), scan.with_name(f"{number}.h5")
        import_scan(source, made)
        for recording in (open_recording(made), open_recording(source)):
            np.testing.assert_allclose(recording.shots.time_zero, zeros)
            assert recording.time_zero == 0
            assert normalise_shots(recording, ShotTreatment())[1].time_zero_s == (0, pytest.approx(zeros[-1]))
        for wrong in (zeros[1:], np.zeros((2, 48)), np.full(zeros.shape, np.nan)):
            with pytest.raises(InvalidInput, match="time_zero is") as refusal:
                import_scan(write(tmp_path / "wrong", t0=wrong, **arrays), scan)
            assert refusal.value.field == "time_zero"


def test_sensors_on_no_plane_are_refused(tmp_path, scan):
    """A curved or tilted arrangement is no planar recording; the message gives its extents."""
    traces, points = foreign.expected(foreign.grid()), np.column_stack([foreign.grid(), foreign.grid()[:, 0]])
    np.savez(tmp_path / "a.npz", traces=traces, positions=points, dt=foreign.DT, c=1480.0)
    with pytest.raises(InvalidInput, match="a plane or a line"):
        import_scan(tmp_path / "a.npz", scan)


def test_preview_of_large_grid_shows_grid_of_even_pitch(tmp_path):
    """Every k-th of 10,000 sensors, one after the other, would appear as stripes."""
    x = np.arange(100) * 1e-4
    places = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2)
    lines = np.random.default_rng(1).normal(size=(len(places), 16)).astype(np.float32)
    np.savez(tmp_path / "a.npz", traces=lines, positions=places, dt=2e-8, c=1480.0)
    shown = np.array(inspect_recording(tmp_path / "a.npz").positions)
    assert 2000 < len(shown) <= 4000
    for axis in shown.T:
        np.testing.assert_allclose(np.diff(np.unique(axis.round(7))), 2e-4)


def test_the_summary_is_a_frozen_value(tmp_path, scan):
    """Callers may keep and compare it."""
    summary = import_scan(*foreign.npz_with_positions(tmp_path)[:1], scan)
    assert summary.format == "npz"
    with pytest.raises(dataclasses.FrozenInstanceError):
        summary.points = 0
