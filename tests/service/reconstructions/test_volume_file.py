"""What ``volume.h5`` holds, as readers other than ours find it."""

import json
import shutil
import subprocess

import h5py
import numpy as np
import pytest

from steradian.imaging import Axes, Volume, reconstruct
from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.reconstructions.exporting import export_volume
from steradian.reconstructions.job import reconstruct_scan
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.volume_file import read_volume, write_volume
from steradian.scans.importing.writing import ImportedAline
from steradian.scans.store import AlineStore, create_scan_file

AXES = Axes(np.arange(5) * 1e-4 - 2e-4, np.arange(4) * 2e-4 - 4e-4, np.arange(6) * 1e-5 + 1e-3)
SPEED = 1487.0


@pytest.fixture(scope="module")
def volume():
    values = np.random.default_rng(0).random((5, 4, 6)).astype(np.float32)
    return Volume(values, AXES, (1e-4, 2e-4, 1e-5), SPEED)


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    path = tmp_path_factory.mktemp("scan") / "scan.h5"
    plan = ScanPlan.create(mask=equi_steradian_mask(10e-3, 3e-3, 60), samples=128, sound_speed=SPEED)
    create_scan_file(path, plan, scan_id="s1", scanner="sim", simulated=True)
    traces = np.random.default_rng(1).integers(-900, 900, (plan.mask.count, 128)).astype(np.int16)
    told = {"scale": 1e-3, "energy": 1.0, "wavelength_m": 1.55e-6, "fire_time_s": 0.0, "quality": 0, "shot": 1}
    with AlineStore(path) as store:
        rows = np.arange(plan.mask.count)
        store.append([ImportedAline(row, trace, **told) for row, trace in enumerate(traces)], rows)
    return path


@pytest.mark.parametrize("how", ["left by a reconstruction", "exported"])
def test_every_dimension_has_the_scale_of_its_axis(tmp_path, volume, how):
    """As netCDF-4 and xarray read HDF5: each dimension of each array is named by one scale of its length."""
    path = tmp_path / "volume.h5"
    write_volume(path, volume, parameters={}, provenance={})
    if how == "exported":
        path = export_volume(path, tmp_path / "exported.h5", format="hdf5")
    wanted = {"values": "xyz", "mip_x": "yz", "mip_y": "xz", "mip_z": "xy"}
    with h5py.File(path) as file:
        for name, letters in wanted.items():
            assert [dimension.label for dimension in file[name].dims] == list(letters)
            scales = [dict(dimension.items()) for dimension in file[name].dims]
            assert [list(found) for found in scales] == [[letter] for letter in letters]
            for letter, length in zip(letters, file[name].shape, strict=True):
                assert file[letter].is_scale
                assert file[letter].attrs["units"] == "m"
                np.testing.assert_allclose(file[letter], getattr(AXES, letter), rtol=1e-12)
                assert len(file[letter]) == length
    again = read_volume(path)
    np.testing.assert_array_equal(again.values, volume.values)
    np.testing.assert_allclose(again.axes.z, AXES.z)


def test_octave_reads_values_and_axes_of_a_file_with_scales(tmp_path, volume):
    program = shutil.which("octave")
    if program is None:
        pytest.skip("needs Octave: apt-get install octave (or dnf, brew install octave)")
    write_volume(tmp_path / "volume.h5", volume, parameters={}, provenance={})
    code = (
        "s = load('-hdf5', 'volume.h5'); printf('%.9g ', size(s.values), s.values(3, 2, 1), s.x, s.z, size(s.mip_z));"
    )
    command = [program, "--no-gui", "--quiet", "--eval", code]
    told = subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, text=True).stdout.split()
    np.testing.assert_allclose(
        np.array(told, float), [6, 4, 5, volume.values[0, 1, 2], *AXES.x, *AXES.z, 4, 5], rtol=1e-6, atol=1e-12
    )


def test_an_image_from_a_line_has_two_scales_and_its_speed(tmp_path):
    flat = Volume(np.ones((5, 6), np.float32), Axes(AXES.x, None, AXES.z), (1e-4, 1e-5), SPEED)
    write_volume(tmp_path / "a.h5", flat, parameters={}, provenance={})
    with h5py.File(tmp_path / "a.h5") as file:
        assert [dimension.label for dimension in file["values"].dims] == ["x", "z"]
        assert "y" not in file
    again = read_volume(tmp_path / "a.h5")
    assert (again.names, again.sound_speed) == (("x", "z"), SPEED)


def test_files_without_scales_still_open(tmp_path, volume):
    write_volume(tmp_path / "a.h5", volume, parameters={"sound_speed": None}, provenance={})
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        for dataset in ("values", "mip_x", "mip_y", "mip_z"):
            for dimension in file[dataset].dims:
                dimension.detach_scale(dimension[0])
        for name in "xyz":
            del file[name]
        file.attrs["parameters"] = json.dumps({"sound_speed": None})
    again = read_volume(tmp_path / "a.h5")
    np.testing.assert_allclose(again.axes.y, AXES.y)
    assert again.sound_speed is None
    export_volume(tmp_path / "a.h5", tmp_path / "b.h5", format="hdf5")


@pytest.mark.parametrize(("asked", "used"), [(None, SPEED), (1520.0, 1520.0)])
def test_the_speed_of_sound_really_used_is_in_report_and_volume_file(tmp_path, scan, asked, used):
    report = reconstruct_scan(scan, tmp_path, ReconstructionParameters(modes=16, sound_speed=asked))
    assert report.sound_speed_m_s == used
    assert json.loads((tmp_path / "report.json").read_text())["parameters"]["sound_speed"] == used
    with h5py.File(tmp_path / "volume.h5") as file:
        assert json.loads(file.attrs["parameters"])["sound_speed"] == used
    volume = read_volume(tmp_path / "volume.h5")
    assert volume.sound_speed == used
    assert volume.spacing[2] == pytest.approx(used * 8e-9)


@pytest.mark.parametrize("method", ["nedner", "iterative"])
def test_an_image_of_the_library_knows_its_speed(method):
    mask = equi_steradian_mask(10e-3, 3e-3, 60)
    traces = np.random.default_rng(1).standard_normal((mask.count, 64))
    made = reconstruct(traces, mask, sampling_interval=8e-9, sound_speed=SPEED, modes=16, method=method)
    assert made.sound_speed == SPEED
