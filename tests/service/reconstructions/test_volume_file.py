"""What ``volume.h5`` holds, as readers other than ours find it."""

import json
import os
import shutil
import subprocess
from dataclasses import replace

import h5py
import numpy as np
import pytest

from steradian.core.exceptions import DamagedFile
from steradian.imaging import Acquisition, ImageGrid, Iterative, Nufft, Volume, VoxelAxes, reconstruct
from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.reconstructions.exporting import export_volume
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.run import reconstruct_scan
from steradian.reconstructions.volumes.file import read_volume, write_volume
from steradian.reconstructions.volumes.pyramid import chunk_shape
from steradian.reconstructions.volumes.reader import VolumeReader
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from steradian.scans.importing.scan_writer import ImportedAline

AXES = VoxelAxes(np.arange(5) * 1e-4 - 2e-4, np.arange(4) * 2e-4 - 4e-4, np.arange(6) * 1e-5 + 1e-3)
SPEED = 1487.0
ABOUT = {"parameters": {}, "provenance": {}}


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
    with ScanFileWriter(path) as store:
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


def test_octave_reads_values_axes_and_levels(tmp_path):
    program = shutil.which("octave")
    if program is None:
        pytest.skip("needs Octave: apt-get install octave (or dnf, brew install octave)")
    values = np.random.default_rng(3).random((131, 4, 6)).astype(np.float32)
    x = np.arange(131) * 1e-4
    write_volume(tmp_path / "volume.h5", Volume(values, replace(AXES, x=x), (1e-4, 2e-4, 1e-5)), **ABOUT)
    code = (
        "s = load('-hdf5', 'volume.h5'); printf('%.9g ', size(s.values), s.values(3, 2, 1), s.x, s.z, size(s.mip_z),"
        " size(s.levels._1), s.levels._1(3, 2, 1));"
    )
    command = [program, "--no-gui", "--quiet", "--eval", code]
    told = subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, text=True).stdout.split()
    np.testing.assert_allclose(
        np.array(told, float),
        [6, 4, 131, values[0, 1, 2], *x, *AXES.z, 4, 131, 3, 2, 66, values[:2, 2:4, 4:].mean()],
        rtol=1e-6,
        atol=1e-12,
    )


@pytest.mark.parametrize(
    ("shape", "chunks"),
    [
        ((226, 226, 1024), (57, 57, 64)),
        ((256, 256, 512), (64, 64, 64)),
        ((100, 96, 97), (50, 96, 49)),
        ((452, 452, 2048), (65, 65, 64)),
        ((5, 4, 6), (5, 4, 6)),
    ],
)
def test_chunks_hardly_stick_out_of_the_volume(shape, chunks):
    assert chunk_shape(shape) == chunks
    padded = np.prod([-(-size // side) * side for size, side in zip(shape, chunks, strict=True)])
    assert padded <= 1.02 * np.prod(shape)


def test_pyramid_levels_are_block_means_with_matching_axes(tmp_path):
    """The halves of odd sides end with means of what is left there."""
    values = np.random.default_rng(3).normal(size=(261, 7, 5)).astype(np.float32)
    lines = [np.arange(size) * step + 0.25 for size, step in zip(values.shape, (1e-4, 2e-4, 1e-5), strict=True)]
    write_volume(tmp_path / "a.h5", Volume(values, VoxelAxes(*lines), (1e-4, 2e-4, 1e-5)), **ABOUT)
    with h5py.File(tmp_path / "a.h5") as file:
        assert file["values"].chunks == (87, 7, 5)
        assert sorted(file["levels"]) == ["1", "2"]
        finer = values
        for level, times in (("1", 2), ("2", 4)):
            places = [[slice(at, at + 2) for at in range(0, size, 2)] for size in finer.shape]
            expected = [[[finer[x, y, z].mean() for z in places[2]] for y in places[1]] for x in places[0]]
            finer = file["levels"][level][()]
            np.testing.assert_allclose(finer, expected, atol=1e-6)
            about = file["levels"][level].attrs
            assert about["axes"] == "x, y, z"
            np.testing.assert_allclose(about["spacing_m"], np.multiply([1e-4, 2e-4, 1e-5], times))
            np.testing.assert_allclose(about["origin_m"], [line[:times].mean() for line in lines])


@pytest.mark.parametrize("kind", ["i2", "i4", "u1", "f2", ">f4", ">f8"])
def test_levels_are_means_of_numbers_of_any_type(tmp_path, kind):
    """A volume that somebody made of another reader's array."""
    values = np.arange(130 * 2 * 2).reshape(130, 2, 2).astype(kind)
    axes = VoxelAxes(*(np.arange(size) * 1e-4 for size in values.shape))
    write_volume(tmp_path / "volume.h5", Volume(values, axes, (1e-4, 1e-4, 1e-4)), **ABOUT)
    with h5py.File(tmp_path / "volume.h5") as file:
        found, stored = file["levels/1"][()], file["values"][()]
    np.testing.assert_array_equal(stored, values)
    np.testing.assert_allclose(found[:, 0, 0], values.astype(float).reshape(65, 8).mean(axis=1), rtol=1e-6)


@pytest.mark.parametrize(("axis", "share"), [(0, 1 / 114), (1, 1 / 2), (2, 1 / 4)])
def test_a_slice_reads_of_the_chunks_that_it_crosses_only(tmp_path, monkeypatch, axis, share):
    values = np.random.default_rng(3).random((114, 114, 256)).astype(np.float32)
    lines = VoxelAxes(*(np.arange(size) * 1e-4 for size in values.shape))
    write_volume(tmp_path / "a.h5", Volume(values, lines, (1e-4, 1e-4, 1e-4)), **ABOUT)
    stored = VolumeReader(tmp_path / "a.h5").level(0)
    read, sizes = os.preadv, []
    monkeypatch.setattr(os, "preadv", lambda file, room, at: sizes.append(len(room[0])) or read(file, room, at))
    index = [slice(0, size, 1) for size in values.shape]
    index[axis] = 50
    np.testing.assert_array_equal(stored.read(tuple(index)), values.take(50, axis))
    assert sum(sizes) <= 1.001 * share * values.nbytes


def test_an_image_from_a_line_has_two_scales_and_its_speed(tmp_path):
    flat = Volume(np.ones((5, 6), np.float32), VoxelAxes(AXES.x, None, AXES.z), (1e-4, 1e-5), SPEED)
    write_volume(tmp_path / "a.h5", flat, parameters={}, provenance={})
    with h5py.File(tmp_path / "a.h5") as file:
        assert [dimension.label for dimension in file["values"].dims] == ["x", "z"]
        assert "y" not in file
    again = read_volume(tmp_path / "a.h5")
    assert (again.names, again.sound_speed) == (("x", "z"), SPEED)


@pytest.mark.parametrize("version", [2, 0, "1", None])
def test_volume_file_of_unknown_version_is_refused_with_the_allowed_one(tmp_path, volume, version):
    write_volume(tmp_path / "a.h5", volume, **ABOUT)
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        del file.attrs["schema_version"]
        if version is not None:
            file.attrs["schema_version"] = version
    with pytest.raises(DamagedFile, match=f"schema_version is {version}; allowed: 1$"):
        read_volume(tmp_path / "a.h5")
    with pytest.raises(DamagedFile, match=f"schema_version is {version}; allowed: 1$"):
        export_volume(tmp_path / "a.h5", tmp_path / "b.h5", format="hdf5")


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


@pytest.mark.parametrize("method", [Nufft(), Iterative()])
def test_an_image_of_the_library_knows_its_speed(method):
    mask = equi_steradian_mask(10e-3, 3e-3, 60)
    traces = np.random.default_rng(1).standard_normal((mask.count, 64))
    made = reconstruct(Acquisition(traces, mask, dt=8e-9, sound_speed=SPEED), ImageGrid(16), method)
    assert made.sound_speed == SPEED
