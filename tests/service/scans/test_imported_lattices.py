"""Imported lattices: the size of a voxel follows their pitch, and gaps move nothing."""

import json

import h5py
import nrrd
import numpy as np
import pytest

from steradian.masks.modes_from_lattice import lattice_modes
from steradian.reconstructions.exporting import export_volume
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.resolve import modes_of
from steradian.reconstructions.pipeline.run import reconstruct_scan
from steradian.scans.exporting import export_scan
from steradian.scans.importing import import_scan
from steradian.scans.opening import open_recording

SHAPES = [(12, 12), (12, 9), (7, 12)]


def places(shape, pitch=250e-6, corner=(10.4e-3, -3e-3)):
    axes = [low + pitch * np.arange(count) for low, count in zip(corner, shape, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)


def import_of(points, folder, name="a", samples=64):
    random = np.random.default_rng(0)
    np.savez(
        folder / f"{name}.npz",
        traces=random.normal(size=(len(points), samples)),
        positions=points,
        sampling_interval=20e-9,
        sound_speed=1500.0,
    )
    import_scan(folder / f"{name}.npz", folder / f"{name}.h5")
    return folder / f"{name}.h5"


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(("pitch", "modes"), [(1e-3, 1), (40e-6, 1), (100e-6, 100 / 60), (250e-6, 250 / 60)])
def test_coarse_or_fine_lattice_has_voxels_of_its_pitch_before_and_after_the_import(tmp_path, shape, pitch, modes):
    scan = import_of(places(shape, pitch), tmp_path)
    for path in (tmp_path / "a.npz", scan):
        assert modes_of(open_recording(path), ReconstructionParameters()) == round(modes * max(shape))


@pytest.mark.parametrize("gaps", [[0], [0, 1, 2, 3], [77], [5, 30, 31, 90, 143], list(range(0, 144, 3))])
def test_missing_sensors_of_a_lattice_move_neither_sensors_nor_voxels(tmp_path, gaps):
    whole, left = places((12, 12), 1e-3), np.delete(places((12, 12), 1e-3), gaps, axis=0)
    full, holed = (open_recording(import_of(points, tmp_path, name)) for name, points in (("a", whole), ("b", left)))
    np.testing.assert_allclose(holed.positions, np.delete(full.positions, gaps, axis=0), atol=1e-12)
    assert (holed.aperture, holed.grid) == (pytest.approx(full.aperture), full.grid)


def test_left_out_sensors_do_not_change_the_size_of_a_voxel(tmp_path):
    recording = open_recording(import_of(places((12, 12), 1e-3), tmp_path))
    assert recording.select(np.arange(144) % 5 > 0).grid == 12


def test_reconstruction_of_coarse_line_defaults_to_one_voxel_per_sensor(tmp_path):
    line = np.column_stack([1e-3 * np.arange(111), np.zeros(111)])
    report = reconstruct_scan(import_of(line, tmp_path), tmp_path / "out", ReconstructionParameters())
    assert report.shape[0] == 111
    assert report.spacing_m[0] == pytest.approx(1e-3)
    assert json.loads((tmp_path / "out" / "report.json").read_text())["parameters"]["modes"] == 111


def test_scattered_sensors_are_no_lattice():
    points = np.random.default_rng(4).uniform(-1e-3, 1e-3, (200, 2))
    assert lattice_modes(points, 2.1e-3) is None
    assert lattice_modes(np.array([[0.0, 0.0], [1e-3, 2e-3]]), 4e-3) is None
    assert lattice_modes(np.array([[0.0], [1e-3], [2.5e-3]]), 4e-3) is None


def brightest(folder, points, ball, name):
    """Import A-lines of a small ball at ``ball`` (x, y, z), reconstruct; returns the folder and the exported NIfTI."""
    times, distance = 20e-9 * np.arange(128), np.linalg.norm(np.column_stack([points, 0 * points[:, 0]]) - ball, axis=1)
    late = (1500 * times - distance[:, None]) / 60e-6
    np.savez(
        folder / f"{name}.npz",
        traces=np.where(np.abs(late) < 1, -late, 0) / distance[:, None],
        positions=points,
        sampling_interval=20e-9,
        sound_speed=1500.0,
    )
    import_scan(folder / f"{name}.npz", folder / f"{name}.h5")
    report = reconstruct_scan(folder / f"{name}.h5", folder / name, ReconstructionParameters())
    return report, folder / name / "volume.h5"


@pytest.mark.parametrize("gaps", [[], [0]])
def test_exports_of_an_imported_lattice_show_an_object_where_the_file_has_it(tmp_path, gaps):
    points = np.delete(places((12, 12)), gaps, axis=0)
    ball = np.array([11.9e-3, -1.5e-3, 1.2e-3])
    report, volume = brightest(tmp_path, points, ball, "a")
    assert report.centre_m == pytest.approx((11.9e-3, -1.5e-3))
    for ending, kind in (("nrrd", "nrrd"), ("h5", "hdf5")):
        export_volume(volume, tmp_path / f"b.{ending}", format=kind)
    header = nrrd.read_header(str(tmp_path / "b.nrrd"))
    values, _ = nrrd.read(str(tmp_path / "b.nrrd"))
    step = np.diag(header["space directions"])
    found = header["space origin"] + step * np.unravel_index(np.argmax(values), values.shape)
    np.testing.assert_allclose(found, 1e3 * ball, atol=0.13)
    with h5py.File(tmp_path / "b.h5") as file:
        at = np.unravel_index(np.argmax(file["values"]), file["values"].shape)
        np.testing.assert_allclose([file[name][n] for name, n in zip("xyz", at, strict=True)], 1e-3 * found, atol=1e-6)
        np.testing.assert_allclose(file["values"].attrs["origin_m"], 1e-3 * header["space origin"], atol=1e-9)


def test_detectors_keep_their_coordinates_through_an_ipasc_file(tmp_path):
    points = places((12, 12))
    scan = import_of(points, tmp_path)
    export_scan(scan, tmp_path / "a.ipasc.h5")
    import_scan(tmp_path / "a.ipasc.h5", tmp_path / "b.h5")
    for path in (scan, tmp_path / "b.h5"):
        recording = open_recording(path)
        np.testing.assert_allclose(recording.positions + recording.centre, points, atol=1e-9)
