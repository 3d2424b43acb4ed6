"""What an import tells: units, offsets, dead channels, wavelengths, positions that are not quite flat, structures."""

import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat

sys.path.insert(0, str(Path(__file__).parent))
import foreign
from test_import_axes import DT, PITCH, SPEED, imported, plane, sensed

from steradian.core.exceptions import DamagedFile, InvalidInput
from steradian.scans.importing import import_scan
from steradian.scans.opening import open_recording

POINTS = plane(10, 12)
LINES = sensed(POINTS)


def archive(folder, **changes):
    about = {"traces": LINES, "positions": POINTS, "dt": DT, "c": SPEED} | changes
    np.savez(folder / "a.npz", **about)
    return folder / "a.npz"


@pytest.mark.parametrize(
    ("changes", "description"),
    [
        ({"positions": 1e3 * POINTS}, {"lengths": "mm"}),
        ({"positions": 1e6 * POINTS, "aperture": 3000.0}, {"lengths": "um"}),
        ({"dt": 1e9 * DT, "t0": 1000.0}, {"times": "ns"}),
        ({"dt": 1e6 * DT, "t0": 1.0, "positions": 1e3 * POINTS}, {"times": "us", "lengths": "mm"}),
        ({"positions": 1e3 * POINTS, "dt": 1e6 * DT}, {"lengths": "mm", "sampling_interval": 20, "times": "ns"}),
    ],
)
def test_import_with_described_units_converts_numbers(tmp_path, changes, description):
    recording, made = imported(tmp_path, archive(tmp_path, **changes), **description)
    np.testing.assert_allclose(recording.positions, POINTS, atol=1e-12)
    assert recording.sampling_interval == pytest.approx(DT)
    assert recording.time_zero == pytest.approx(1e-6 if "t0" in changes else 0)
    assert any("were taken in" in note for note in made.notes)


def test_file_in_another_unit_is_refused_by_a_hint_that_works(tmp_path):
    source = archive(tmp_path, positions=1e3 * POINTS)
    with pytest.raises(InvalidInput, match=r'no length of its own, {"lengths": "mm"}'):
        import_scan(source, tmp_path / "scan.h5")
    with pytest.raises(InvalidInput, match=r'count as s; .* {"times": "us"}'):
        import_scan(archive(tmp_path, dt=1e6 * DT), tmp_path / "scan.h5")


def test_import_of_sampling_rate_sets_sampling_interval(tmp_path):
    np.savez(tmp_path / "a.npz", traces=LINES, positions=POINTS, fs=1 / DT, c=SPEED)
    assert imported(tmp_path, tmp_path / "a.npz")[0].sampling_interval == pytest.approx(DT)


def test_import_of_counts_around_mid_scale_notes_offset(tmp_path):
    counts = (32_768 + np.rint(10_000 * LINES)).astype(np.uint16)
    _, made = imported(tmp_path, archive(tmp_path, traces=counts))
    assert any("offset of 3.277e+04" in note for note in made.notes)


def test_import_of_constant_channels_notes_dead_channels(tmp_path):
    lines = LINES.copy()
    lines[[3, 50, 51]] = 0
    _, made = imported(tmp_path, archive(tmp_path, traces=lines))
    assert made.notes == ("3 of 120 A-lines are constant (3, 50, 51): dead channels count as sensors without signal",)


def test_import_of_ipasc_wavelengths_in_nm_converts_them_with_note(tmp_path):
    source, _ = foreign.ipasc_by_pacfish(tmp_path, wavelengths=2)
    with h5py.File(source, "r+") as file:
        file["meta_data/acquisition_wavelengths"][...] = [750, 850]
    made = import_scan(source, tmp_path / "scan.h5")
    with h5py.File(made.path) as file:
        np.testing.assert_allclose(file["plan/frame_excitation"][()], [750e-9, 850e-9])
    assert any("in nm" in note for note in made.notes)


def test_import_of_implausible_wavelengths_ignores_them_with_note(tmp_path):
    source, _ = foreign.ipasc_by_pacfish(tmp_path, wavelengths=2)
    with h5py.File(source, "r+") as file:
        file["meta_data/acquisition_wavelengths"][...] = [0.75, 0.85]
    assert any("not used" in note for note in import_scan(source, tmp_path / "scan.h5").notes)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_import_of_nearly_flat_positions_takes_them_as_flat_with_note(tmp_path, axis):
    height = np.random.default_rng(1).uniform(-2e-6, 2e-6, len(POINTS))
    where = np.insert(plane(10, 12) * 4, axis, height, axis=1)
    recording, made = imported(tmp_path, archive(tmp_path, positions=where))
    assert recording.positions.shape == (120, 2)
    assert f"along {'xyz'[axis]}, taken as flat (allowed: 10 µm" in made.notes[0]


def test_positions_that_are_not_flat_are_refused_with_the_tolerance(tmp_path):
    height = np.random.default_rng(1).uniform(-50e-6, 50e-6, len(POINTS))
    with pytest.raises(InvalidInput, match="flat to 10 µm"):
        import_scan(archive(tmp_path, positions=np.column_stack([POINTS, height])), tmp_path / "scan.h5")


def kwave_structures():
    voxels = np.zeros((12, 10, 8))
    voxels[:, :, 3] = 1
    points = plane(12, 10)
    lines = sensed(points)[np.arange(120).reshape(12, 10).T.ravel()]  # MATLAB counts the first axis fastest
    return (
        points,
        lines,
        {
            "sensor_data": {"p": lines},
            "kgrid": {"dt": DT, "dx": PITCH, "Nx": 12.0},
            "sensor": {"mask": voxels, "record": 1.0},
            "medium": {"sound_speed": SPEED, "density": 1000.0},
        },
    )


@pytest.mark.parametrize("compressed", [False, True])
def test_matlab_5_structures_as_kwave_has_them_need_no_description(tmp_path, compressed):
    points, _, held = kwave_structures()
    savemat(tmp_path / "a.mat", held, do_compression=compressed)
    recording, _ = imported(tmp_path, tmp_path / "a.mat")
    assert (recording.sampling_interval, recording.sound_speed) == (DT, SPEED)
    np.testing.assert_allclose(recording.traces, sensed(recording.positions), atol=2e-6)
    assert {tuple(each) for each in recording.positions.round(9)} == {tuple(each) for each in points.round(9)}


def test_matlab_7_3_structures_as_kwave_has_them_need_no_description(tmp_path):
    _, _, held = kwave_structures()
    flat = {f"{name}/{field}": value for name, fields in held.items() for field, value in fields.items()}
    source = foreign._matlab(tmp_path / "a.mat", **{name: np.asarray(value, "f8") for name, value in flat.items()})
    recording, _ = imported(tmp_path, source)
    assert (recording.sampling_interval, recording.sound_speed) == (DT, SPEED)
    np.testing.assert_allclose(recording.traces, sensed(recording.positions), atol=2e-6)


@pytest.mark.parametrize("option", ["-v7", "-hdf5"])
def test_octave_structures_are_read(tmp_path, option):
    if shutil.which("octave") is None:
        pytest.skip("no Octave")
    np.savetxt(tmp_path / "lines.txt", LINES)
    np.savetxt(tmp_path / "where.txt", POINTS)
    code = f"scan.raw.data=load('lines.txt'); positions=load('where.txt'); kgrid.dt={DT}; medium.sound_speed={SPEED};"
    command = ["octave", "--no-gui", "--quiet", "--eval", f"{code} save {option} out.x scan positions kgrid medium"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    recording, _ = imported(tmp_path, tmp_path / "out.x", array="scan.raw.data")
    np.testing.assert_allclose(recording.traces, LINES, atol=1e-6)
    assert recording.sampling_interval == pytest.approx(DT)


def test_array_in_a_nested_structure_is_named_by_its_path(tmp_path):
    savemat(tmp_path / "a.mat", {"scan": {"raw": {"data": LINES}}, "positions": POINTS, "dt": DT, "c": SPEED})
    recording, _ = imported(tmp_path, tmp_path / "a.mat", array="scan.raw.data")
    np.testing.assert_array_equal(recording.traces, LINES.astype("f4"))
    about = foreign.describe(tmp_path, array="scan.other")
    with pytest.raises(DamagedFile, match=r"the fields of scan are scan\.raw"):
        import_scan(tmp_path / "a.mat", tmp_path / "other.h5", description=about)


def test_cells_are_refused_by_advice_that_works(tmp_path):
    cells = np.empty((1, 2), object)
    cells[0, 0], cells[0, 1] = LINES, LINES
    savemat(tmp_path / "a.mat", {"sensor_data": cells, "dt": DT})
    with pytest.raises(DamagedFile, match=r"sensor_data is a cell; .* sensor_data = sensor_data\{1\}"):
        import_scan(tmp_path / "a.mat", tmp_path / "scan.h5")


def test_remarks_stay_in_the_scan_file_and_in_the_report_of_an_image(tmp_path):
    _, made = imported(tmp_path, archive(tmp_path, positions=1e3 * POINTS), lengths="mm")
    again = import_scan(made.path, tmp_path / "again.h5")
    assert open_recording(again.path).notes == made.notes != ()
