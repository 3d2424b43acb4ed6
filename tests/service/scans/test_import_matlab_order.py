"""Arrays of MATLAB, SciPy and h5py: whose axes and whose order of a mask's voxels, told by marks and by the samples."""

import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat

sys.path.insert(0, str(Path(__file__).parent))
import foreign
from test_import_axes import DT, PITCH, SPEED, imported, plane, sensed

from steradian.core.exceptions import InvalidInput
from steradian.scans.importing import import_scan


def by_h5py(path, **variables):
    with h5py.File(path, "w") as file:
        for name, value in variables.items():
            file[name] = value
    return path


def by_matlab_7_3(path, **variables):
    return foreign._matlab(path, **{name: np.asarray(value, "f8") for name, value in variables.items()})


def by_scipy(path, **variables):
    savemat(path, variables)
    return path


WRITERS = [by_h5py, by_matlab_7_3, by_scipy]


@pytest.mark.parametrize("shape", [(10, 10), (12, 12)])
@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("write", WRITERS)
def test_array_with_as_many_samples_as_sensors_is_read_in_either_orientation(tmp_path, write, turned, shape):
    points = plane(*shape)
    lines = sensed(points, samples=len(points))
    array = lines.T if turned else lines
    source = write(tmp_path / "a", sensor_data=array, positions=points, dt=DT, c0=SPEED)
    recording, _ = imported(tmp_path, source)
    np.testing.assert_array_equal(recording.traces, lines.astype("f4"))


@pytest.mark.parametrize("write", WRITERS)
def test_array_with_time_first_is_turned_by_the_number_of_positions(tmp_path, write):
    """Version 5 is what MATLAB's save writes by default."""
    points = plane(10, 10)
    source = write(tmp_path / "a", sensor_data=sensed(points).T, positions=points, dt=DT, c0=SPEED)
    recording, made = imported(tmp_path, source)
    assert (made.points, made.samples) == (100, 150)
    np.testing.assert_array_equal(recording.traces, sensed(points).astype("f4"))


@pytest.mark.parametrize("counts", [(12, 10), (16, 16)])
@pytest.mark.parametrize("axes", ["x, y, time", "time, x, y"])
@pytest.mark.parametrize("write", WRITERS)
def test_array_of_three_axes_is_read_as_its_program_shows_it(tmp_path, write, axes, counts):
    points = plane(*counts)
    cube = sensed(points).reshape(*counts, -1)
    array = cube if axes == "x, y, time" else cube.transpose(2, 0, 1)
    source = write(tmp_path / "a", sensor_data=array, dx=PITCH, dt=DT, c0=SPEED)
    recording, _ = imported(tmp_path, source)
    np.testing.assert_array_equal(recording.traces, cube.reshape(len(points), -1).astype("f4"))
    np.testing.assert_allclose(recording.positions, points, atol=1e-12)


def test_hdf5_array_with_ambiguous_time_axis_is_refused(tmp_path):
    noise = np.random.default_rng(1).normal(size=(20, 20))
    source = by_h5py(tmp_path / "a", sensor_data=noise, positions=plane(5, 4), dt=DT, c0=SPEED)
    with pytest.raises(InvalidInput, match='"axes": "time, sensor"'):
        import_scan(source, tmp_path / "scan.h5")
    recording, _ = imported(tmp_path, source, axes="sensor, time")
    np.testing.assert_array_equal(recording.traces, noise.astype("f4"))


def mask():
    """An L in a plane of constant z, its voxels in Python's order, and MATLAB's order of them."""
    voxels = np.zeros((20, 18, 10), "u1")
    voxels[:8, :, 4] = voxels[:, :7, 4] = 1
    places = np.argwhere(voxels)
    points = (places - np.array(voxels.shape) // 2) * PITCH
    return voxels, points[:, :2], np.lexsort(places.T)


@pytest.mark.parametrize("order", ["matlab", "python"])
@pytest.mark.parametrize("write", WRITERS)
def test_rows_of_a_binary_mask_are_put_where_neighbours_are_alike(tmp_path, write, order):
    voxels, points, matlab = mask()
    rows = sensed(points) if order == "python" else sensed(points[matlab])
    recording, made = imported(
        tmp_path, write(tmp_path / "a", sensor_data=rows, mask=voxels, dx=PITCH, dt=DT, c0=SPEED)
    )
    truth = sensed(recording.positions + points.mean(axis=0) - recording.positions.mean(axis=0))
    np.testing.assert_allclose(recording.traces, truth, atol=1e-6)
    assert any("Python's" in note for note in made.notes) == (order == "python")


def test_rows_of_a_binary_mask_without_evidence_are_refused_until_their_order_is_named(tmp_path):
    voxels, points, _ = mask()
    noise = np.random.default_rng(1).normal(size=(len(points), 150))
    source = by_scipy(tmp_path / "a", sensor_data=noise, mask=voxels, dx=PITCH, dt=DT, c0=SPEED)
    with pytest.raises(InvalidInput, match="mask_order is missing"):
        import_scan(source, tmp_path / "scan.h5")
    recording, _ = imported(tmp_path, source, mask_order="python")
    np.testing.assert_allclose(recording.positions - recording.positions[0], points - points[0], atol=1e-9)


def test_rows_of_a_binary_mask_by_matlab_without_evidence_are_in_its_order(tmp_path):
    voxels, points, matlab = mask()
    noise = np.random.default_rng(1).normal(size=(len(points), 150))
    source = by_matlab_7_3(tmp_path / "a", sensor_data=noise, mask=voxels, dx=PITCH, dt=DT, c0=SPEED)
    recording, made = imported(tmp_path, source)
    np.testing.assert_allclose(recording.positions - recording.positions[0], points[matlab] - points[0], atol=1e-9)
    assert "MATLAB's" in made.notes[0]
