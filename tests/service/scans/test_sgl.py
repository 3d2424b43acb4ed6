"""``.sgl`` files, the raw recordings of LabVIEW-controlled scanners, against a writer and reader of the tests' own."""

import json
import sys
from pathlib import Path
from random import Random

import h5py
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
import foreign
from sgl_files import NAME, TRAILER, read_sgl, write_sgl

from steradian.core.exceptions import DamagedFile, InvalidInput, SteradianError
from steradian.scans.exporting import export_scan
from steradian.scans.importing import import_scan
from steradian.scans.importing.inspect import inspect_recording
from steradian.scans.opening import open_recording


def source_of(scan):
    with h5py.File(scan) as file:
        return json.loads(file.attrs["source"])


def imported(folder, name=NAME, **fields):
    source = write_sgl(folder / name, **fields)
    return source, import_scan(source, folder / "scan.h5")


def test_sgl_with_all_fields_lands_where_each_belongs(tmp_path):
    source, made = imported(tmp_path)
    truth = read_sgl(source)
    recording = open_recording(made.path)
    np.testing.assert_array_equal(recording.traces, truth["samples"])
    assert recording.traces.dtype == np.float32
    assert (recording.sampling_interval, recording.time_zero) == (20e-9, 0)
    with h5py.File(made.path) as file:
        assert json.loads(file["mask"].attrs["arrangement"])["centre_m"] == pytest.approx(
            [3.5e-3 + 6 * 0.2e-3, -2e-3 + 4 * 0.3e-3]
        )
        assert file["plan/frame_excitation"][()].tolist() == [750e-9]
        assert set(file["alines/averages"][()]) == {16}
        assert file["plan"].attrs["averages"] == 16
        centre = json.loads(file["mask"].attrs["arrangement"])["centre_m"]
        np.testing.assert_allclose(file["mask/positions"][()] + centre, truth["positions"], atol=1e-9)
    about = source_of(made.path)
    assert about["name"] == NAME
    assert about["sgl"]["interrogation_source"] == "Santec"
    assert (about["sgl"]["cut_off_hz"], about["sgl"]["mean_pulse_energy"]) == (20e6, 21.5)
    assert (about["sgl"]["pulse_index"], about["sgl"]["origin_mm"]) == (1, [3.5, -2])
    assert any("1500 m/s is assumed" in note for note in made.notes)


@pytest.mark.parametrize("trailing", range(len(TRAILER) + 1))
@pytest.mark.parametrize("counts", [(12, 8), (12, 1), (1, 8)])
def test_sgl_to_scan_to_sgl_returns_the_same_bytes(tmp_path, counts, trailing):
    source, made = imported(tmp_path, counts=counts, trailer=TRAILER[:trailing])
    again = import_scan(made.path, tmp_path / "moved.h5")  # also after the scan file itself has travelled
    export_scan(again.path, tmp_path / "back.sgl", format="sgl")
    assert (tmp_path / "back.sgl").read_bytes() == source.read_bytes()


def test_sgl_of_odd_values_returns_the_same_bytes(tmp_path):
    """Negative zeros, the smallest numbers, a pitch with no exact decimal, nan where a number is not known."""
    odd = np.array([-0.0, 1e-45, -3e-39, 1e15, np.pi], np.float32)
    samples = np.resize(odd, (96, foreign.SAMPLES))
    trailer = (0, 0, np.nan, np.inf, 0, -1, np.nan, 1e30)
    source, made = imported(tmp_path, samples=samples, steps=(106.3, 99.99), trailer=trailer)
    export_scan(made.path, tmp_path / "back.sgl", format="sgl")
    assert (tmp_path / "back.sgl").read_bytes() == source.read_bytes()


def test_sgl_file_without_extension_is_recognised_by_length(tmp_path):
    source = write_sgl(tmp_path / "upload")
    assert inspect_recording(source).format == "sgl"
    assert inspect_recording(source).notes


def test_sgl_image_has_the_ball_where_it_is(tmp_path):
    """Positions are centred; x is the fastest axis of the file."""
    from steradian.reconstructions.parameters import ReconstructionParameters
    from steradian.reconstructions.pipeline.run import reconstruct_in_memory

    samples = foreign.expected(foreign.grid()).reshape(*foreign.COUNTS, -1).swapaxes(0, 1).reshape(96, -1)
    source = write_sgl(tmp_path / "a.sgl", samples=samples, trailer=())
    chosen = ReconstructionParameters.create(sound_speed=foreign.SPEED)
    volume = reconstruct_in_memory(open_recording(source), chosen)
    place = np.unravel_index(np.abs(volume.values).argmax(), volume.values.shape)
    found = [volume.origin[axis] + place[axis] * volume.spacing[axis] for axis in range(3)]
    np.testing.assert_allclose(found, foreign.BALL.centres[0], atol=0.15e-3)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("a@800nm_dx[200µm].sgl", "the name states 800 nm, the file 750 nm"),
        ("a_dx[250µm]_dy[300µm].sgl", "the name states dx = 250 µm, the header 200 µm"),
        ("a_dy[0.1mm].sgl", "the name states dy = 100 µm, the header 300 µm"),
        ("a_dt[17ns].sgl", "the name states dt = 17 ns, the header 20 ns"),
        ("a_avg4_2D_raw.sgl", "the name states 4 averages, the file 16"),
    ],
)
def test_sgl_file_name_contradicting_header_is_noted(tmp_path, name, words):
    _, made = imported(tmp_path, name)
    assert any(words in note for note in made.notes), made.notes
    assert open_recording(made.path).sampling_interval == 20e-9


def test_sgl_file_name_supplies_missing_metadata(tmp_path):
    _, made = imported(tmp_path, "a@532nm_t0[-7]_dx[200μm]_dt[20ns]_avg8_2D_raw.SGL", trailer=())
    with h5py.File(made.path) as file:
        assert file["plan/frame_excitation"][()].tolist() == [532e-9]
        assert set(file["alines/averages"][()]) == {8}
    assert open_recording(made.path).time_zero == pytest.approx(-7 * 20e-9)
    assert any("t0[-7]" in note for note in made.notes)
    told = []
    export_scan(made.path, tmp_path / "back.sgl", format="sgl", notes=told)
    assert "_t0[-7]" in told[0]
    with pytest.raises(InvalidInput, match=r"t0\[-7\]"):
        export_scan(made.path, tmp_path / "back_t0[3].sgl", format="sgl")


def test_trigger_delay_and_samples_add_up(tmp_path):
    source = write_sgl(tmp_path / "a_t0[3].sgl")
    options = {"time_zero": 5e-6, "time_zero_samples": -7, "sound_speed": 1540.0}
    made = import_scan(source, tmp_path / "scan.h5", options=options)
    recording = open_recording(made.path)
    assert recording.time_zero == pytest.approx(5e-6 - 7 * 20e-9)
    assert recording.sound_speed == 1540
    assert not any("assumed" in note or "t0[3]" in note for note in made.notes)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda data: data[:-4000], "truncated"),
        (lambda data: data + bytes(4), "numbers behind"),
        (lambda data: data[:-1], "bytes"),
        (lambda data: data[:20], "bytes"),
        (lambda data: data[:24] + 2 * data[24:-32] + data[-32:], r"two-plane \(V-shape\)"),
        (lambda data: np.array([11.5], ">f4").tobytes() + data[4:], "Nx"),
        (lambda data: data[:12] + np.array([-200], ">f4").tobytes() + data[16:], "dx"),
        (lambda data: data[:20] + np.array([np.nan], ">f4").tobytes() + data[24:], "dt"),
        (lambda data: data[:100] + np.array([np.inf], ">f4").tobytes() + data[104:], "traces"),
    ],
)
def test_sgl_file_contradicting_its_header_is_refused(tmp_path, change, words):
    source = write_sgl(tmp_path / "a.sgl")
    source.write_bytes(change(source.read_bytes()))
    with pytest.raises((DamagedFile, InvalidInput), match=words):
        import_scan(source, tmp_path / "scan.h5")
    assert not (tmp_path / "scan.h5").exists()


def test_sgl_of_a_two_plane_scanner_is_refused_by_its_name(tmp_path):
    with pytest.raises(DamagedFile, match="two-plane"):
        import_scan(write_sgl(tmp_path / "mouse_V-shape@750nm.sgl"), tmp_path / "scan.h5")


def test_export_as_sgl_of_points_on_no_grid_is_refused(tmp_path):
    points = np.random.default_rng(1).uniform(-1e-3, 1e-3, (20, 2))
    np.savez(tmp_path / "a.npz", traces=np.ones((20, 64)), positions=points, dt=2e-8, c=1500.0)
    scan = import_scan(tmp_path / "a.npz", tmp_path / "scan.h5").path
    with pytest.raises(InvalidInput, match="fill no grid"):
        export_scan(scan, tmp_path / "out.sgl", format="sgl")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.npz", "scan.h5"]


def test_export_as_sgl_of_another_scan_is_read_back_alike(tmp_path):
    """Points in any order and integers with a scale become a file that says what it knows."""
    source, _ = foreign.npz_with_positions(tmp_path)
    scan = import_scan(source, tmp_path / "scan.h5").path
    export_scan(scan, tmp_path / "out.sgl", format="sgl")
    truth = read_sgl(tmp_path / "out.sgl")
    before, after = open_recording(scan), open_recording(tmp_path / "out.sgl")
    order = np.lexsort(before.positions.T.round(9))
    np.testing.assert_allclose(after.traces, before.traces[order])
    np.testing.assert_allclose(after.positions, before.positions[order], atol=1e-9)
    assert np.isnan(truth["trailer"][2])
    assert len(truth["trailer"]) == len(TRAILER)


def try_mutants(folder, count, seed=1):
    """Import so many mutated files; each is refused, or says what the tests' own reader reads from it."""
    from import_fuzz import mutate

    ends = {"refused": 0, "imported": 0}
    bases = [
        write_sgl(
            folder / f"base-{number}", counts=counts, samples=np.ones((counts[0] * counts[1], 16)), trailer=trailer
        )
        for number, (counts, trailer) in enumerate([((4, 3), TRAILER), ((5, 1), ()), ((1, 6), TRAILER[:5])])
    ]
    data = [base.read_bytes() for base in bases]
    for number in range(count):
        random = Random(f"{seed}/{number}")
        source, scan = folder / "mutant.sgl", folder / "scan.h5"
        source.write_bytes(mutate(data[number % 3], random))
        scan.unlink(missing_ok=True)
        try:
            import_scan(source, scan)
        except SteradianError:
            ends["refused"] += 1
            continue
        ends["imported"] += 1
        truth, recording = read_sgl(source), open_recording(scan)
        np.testing.assert_array_equal(recording.traces, truth["samples"])
        assert recording.sampling_interval == pytest.approx(truth["interval"], rel=1e-6)
        with h5py.File(scan) as file:
            about = json.loads(file["mask"].attrs["arrangement"])
            axes = ["xy".index(axis) for axis in about["axes"]]
            wanted = truth["positions"][:, axes]
            shift = np.array(about["centre_m"])
            np.testing.assert_allclose(recording.positions + shift, wanted, atol=1e-6 * np.abs(wanted).max() + 1e-12)
    return ends


def test_mutated_sgl_is_refused_or_read_right(tmp_path):
    ends = try_mutants(tmp_path, 60)
    assert min(ends.values()) > 5


@pytest.mark.parametrize(
    "seed",
    [pytest.param(seed, marks=pytest.mark.long if seed < 12 else pytest.mark.nightly) for seed in range(10, 30)],
)
def test_five_hundred_of_ten_thousand_mutated_sgl_are_refused_or_read_right(tmp_path, seed):
    ends = try_mutants(tmp_path, 500, seed)
    assert min(ends.values()) > 50
