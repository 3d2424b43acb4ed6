"""What an array's axes mean: stated, told by the samples, or asked for; never guessed in silence."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

sys.path.insert(0, str(Path(__file__).parent))
import foreign

from fabry_perot.simulator.phantoms import Balls, pressure
from steradian.core.exceptions import InvalidInput
from steradian.scans.importing import import_scan
from steradian.scans.opening import open_recording

DT, SPEED, PITCH = 2e-8, 1500.0, 2e-4
BALLS = Balls(
    np.array([[0.9e-3, -0.5e-3, 2e-3], [-1e-3, 0.9e-3, 3e-3], [0.3e-3, 1.3e-3, 2.6e-3]]),
    np.full(3, 1e-4),
    np.array([1.0, 0.6, 0.8]),
)


def sensed(positions, samples=150):
    return pressure(BALLS, positions, DT * np.arange(samples), SPEED)


def plane(*counts):
    lines = [(np.arange(count) - count // 2) * PITCH for count in counts]
    return np.stack(np.meshgrid(*lines, indexing="ij"), -1).reshape(-1, 2)


def bent_plane():
    """Places of a mask in the shape of an L."""
    points = plane(20, 18)
    return points[(points[:, 0] < 0) | (points[:, 1] < -1e-3)]


def imported(folder, source, **description):
    about = foreign.describe(folder, **description) if description else None
    made = import_scan(source, folder / "scan.h5", description=about)
    return open_recording(made.path), made


@pytest.mark.parametrize("turned", [False, True])
def test_npz_p_of_a_partial_mask_is_refused_and_positions_are_asked_for(tmp_path, turned):
    p = sensed(bent_plane())
    np.savez(tmp_path / "a.npz", p=p.T if turned else p, dt=DT, dx=PITCH, c0=SPEED)
    with pytest.raises(InvalidInput, match="positions is missing: the A-lines") as refused:
        import_scan(tmp_path / "a.npz", tmp_path / "scan.h5")
    assert "mask" in refused.value.allowed


@pytest.mark.parametrize("suffix", ["npz", "mat"])
def test_kwave_recording_without_mask_names_what_places_its_sensors(tmp_path, suffix):
    source, name = tmp_path / f"a.{suffix}", "p" if suffix == "npz" else "the A-lines"
    if suffix == "npz":
        np.savez(source, p=sensed(bent_plane()), dt=DT, c0=SPEED)
    else:
        savemat(source, {"sensor_data": sensed(bent_plane()), "dt": DT, "c": SPEED})
    with pytest.raises(InvalidInput, match="positions is missing") as refused:
        import_scan(source, tmp_path / "scan.h5")
    for each in (f"beside {name}", "mask, with its pitch dx", "positions or a grid (interval, count)", "description"):
        assert each in refused.value.allowed


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("case", ["points", "file", "grid", "line", "matlab"])
def test_kwave_recording_without_mask_is_placed_by_its_description(tmp_path, case, turned):
    """Pressure at the imported positions, whichever axis time is."""
    points = bent_plane() if case in {"points", "file"} else plane(20, 18)
    points = points[:20] if case == "line" else points
    if case == "line":
        points = np.column_stack([(np.arange(20) - 10) * PITCH, np.zeros(20)])
    lines = sensed(points).astype("f4")
    array = lines.T if turned else lines
    source = tmp_path / ("a.mat" if case == "matlab" else "a.npz")
    if case == "matlab":
        savemat(source, {"sensor_data": array, "dt": DT, "c": SPEED})
    else:
        np.savez(source, p=array, dt=DT, c0=SPEED)
    np.savetxt(tmp_path / "sensors.csv", points, delimiter=",")
    stated = {
        "points": {"positions": points.tolist()},
        "file": {"positions": "sensors.csv"},
        "line": {"grid": {"interval": [PITCH]}},
    }
    grid = {"grid": {"count": [20, 18], "interval": [PITCH, PITCH]}}
    recording, made = imported(tmp_path, source, **stated.get(case, grid))
    assert made.points == len(points)
    np.testing.assert_array_equal(recording.traces, lines)
    found = recording.positions - recording.positions.mean(axis=0)
    np.testing.assert_allclose(found, (points - points.mean(axis=0))[:, : found.shape[1]], atol=1e-9)


@pytest.mark.parametrize("dtype", ["f4", "f8", "i2", "u2", ">f4"])
@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("sensors", [96, 150, 220])
def test_npz_p_of_a_line_is_read_in_either_orientation(tmp_path, sensors, turned, order, dtype):
    pitch = 7e-3 / sensors
    points = np.column_stack([(np.arange(sensors) - sensors // 2) * pitch, np.zeros(sensors)])
    lines = np.rint(20_000 * sensed(points))
    lines = (lines + (32_768 if dtype == "u2" else 0)).astype(dtype)
    np.savez(tmp_path / "a.npz", p=np.asarray(lines.T if turned else lines, order=order), dt=DT, dx=pitch, c0=SPEED)
    recording, made = imported(tmp_path, tmp_path / "a.npz")
    np.testing.assert_array_equal(recording.traces, lines)
    np.testing.assert_allclose(recording.positions[:, 0], points[:, 0], atol=1e-12)
    assert any("was taken as" in note for note in made.notes)
    assert any("taken as a line" in note for note in made.notes)


def test_npz_p_that_could_be_either_is_refused_until_axes_are_named(tmp_path):
    noise = np.random.default_rng(1).normal(size=(40, 30))
    np.savez(tmp_path / "a.npz", p=noise, dt=DT, dx=PITCH, c0=SPEED)
    with pytest.raises(InvalidInput, match='"axes": "time, sensor"'):
        import_scan(tmp_path / "a.npz", tmp_path / "scan.h5")
    recording, _ = imported(tmp_path, tmp_path / "a.npz", axes="sensor, time")
    np.testing.assert_array_equal(recording.traces, noise.astype("f4"))


def test_npz_p_with_positions_fits_them_in_either_orientation(tmp_path):
    points = bent_plane()
    np.savez(tmp_path / "a.npz", p=sensed(points), positions=points, dt=DT, c0=SPEED)
    recording, made = imported(tmp_path, tmp_path / "a.npz")
    np.testing.assert_array_equal(recording.traces, sensed(points).astype("f4"))
    assert "positions fit" in made.notes[0]


@pytest.mark.parametrize("turned", [False, True])
def test_npz_p_of_a_grid_is_read_with_time_first_or_last(tmp_path, turned):
    cube = sensed(plane(16, 14)).reshape(16, 14, -1)
    np.savez(tmp_path / "a.npz", p=cube.transpose(2, 0, 1) if turned else cube, dt=DT, dx=PITCH, c0=SPEED)
    recording, _ = imported(tmp_path, tmp_path / "a.npz")
    np.testing.assert_array_equal(recording.traces, cube.reshape(16 * 14, -1).astype("f4"))


ORDERS = ["x, y, time", "time, x, y", "time, y, x", "y, time, x", "point, time", "time, sensor"]


@pytest.mark.parametrize("suffix", ["npy", "npz", "mat", "h5"])
@pytest.mark.parametrize("axes", ORDERS)
def test_axes_named_in_any_order_give_the_same_scan(tmp_path, axes, suffix):
    truth = np.arange(4 * 3 * 20, dtype="f4").reshape(4, 3, 20)
    wanted = [name.strip() for name in axes.split(",")]
    if "x" in wanted:
        array = truth.transpose(["xyt".index(name[0]) for name in wanted])
    else:
        array = truth if wanted[0] == "point" else truth.transpose(2, 0, 1)
    source = written(tmp_path / f"a.{suffix}", array)
    recording, _ = imported(
        tmp_path, source, axes=axes, sampling_interval=DT, sound_speed=SPEED, grid={"interval": [PITCH, 2 * PITCH]}
    )
    np.testing.assert_array_equal(recording.traces, truth.reshape(12, 20))
    assert len(np.unique(recording.positions[:, 0].round(9))) == 4


@pytest.mark.parametrize("suffix", ["npy", "npz", "mat", "h5"])
@pytest.mark.parametrize(
    "axes", ["frame, sensor, time", "time, sensor, frame", "time, frame, point", "frame, time, x, y"]
)
def test_frames_among_the_axes_become_frames_of_the_scan(tmp_path, axes, suffix):
    truth = np.arange(2 * 4 * 3 * 20, dtype="f4").reshape(2, 4, 3, 20)
    lines = truth.reshape(2, 12, 20)
    grids = truth.transpose(0, 3, 1, 2)
    array = {
        "frame, sensor, time": lines,
        "time, sensor, frame": lines.T,
        "frame, time, x, y": grids,
        "time, frame, point": lines.transpose(2, 0, 1),
    }[axes]
    grid = {"count": [4, 3], "interval": [PITCH, PITCH]}
    source = written(tmp_path / f"a.{suffix}", array)
    _, made = imported(tmp_path, source, axes=axes, sampling_interval=DT, sound_speed=SPEED, grid=grid)
    for frame in range(2):
        np.testing.assert_array_equal(open_recording(made.path, frame).traces, truth[frame].reshape(12, 20))


@pytest.mark.parametrize("axes", ["time", "x, y", "time, time", "point, x, time", "time, y", "time, sensor, channel"])
def test_axes_that_name_no_order_are_refused(tmp_path, axes):
    np.save(tmp_path / "a.npy", np.ones((4, 3, 20)))
    with pytest.raises(InvalidInput, match="time and point"):
        imported(tmp_path, tmp_path / "a.npy", axes=axes, sampling_interval=DT, sound_speed=SPEED)


def test_axes_of_another_number_than_the_array_has_are_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.ones((4, 20)))
    with pytest.raises(InvalidInput, match="2 names"):
        imported(tmp_path, tmp_path / "a.npy", axes="time, x, y", sampling_interval=DT, sound_speed=SPEED)


def written(path, array):
    """Write an array into a file of the kind that the name says; in .h5 as h5py does, without MATLAB's marks."""
    import h5py

    match path.suffix:
        case ".npy":
            np.save(path, array)
        case ".npz":
            np.savez(path, traces=array)
        case ".mat":
            savemat(path, {"sensor_data": array})
        case ".h5":
            with h5py.File(path, "w") as file:
                file["sensor_data"] = array
    return path


@pytest.mark.parametrize("case", ["python order", "MATLAB order", "time first", "cartesian"])
def test_kwave_python_result_with_its_mask_needs_no_description(tmp_path, case):
    """A ball off the middle of a plane of 20 × 14 sensors, in closed form: each A-line is that of its place."""
    mask = np.zeros((6, 20, 14), bool)
    mask[0] = True
    places = (np.argwhere(mask) - np.array(mask.shape) // 2) * 0.2e-3

    def lines(y, z):
        way = np.sqrt((y - 0.3e-3) ** 2 + (z + 0.9e-3) ** 2 + 3e-3**2)[:, None] - np.arange(300) * 20e-9 * 1500
        return (1e7 * way * np.exp(-((way / 1e-4) ** 2))).astype(np.float32)

    p = lines(places[:, 1], places[:, 2])
    if case == "MATLAB order":
        p = p.reshape(20, 14, -1).transpose(1, 0, 2).reshape(280, -1)
    sensors = places.T if case == "cartesian" else mask
    np.savez(tmp_path / "a.npz", p=p.T if case == "time first" else p, dt=20e-9, dx=0.2e-3, c0=1500.0, mask=sensors)
    assert import_scan(tmp_path / "a.npz", tmp_path / "scan.h5").points == 280
    held = open_recording(tmp_path / "scan.h5")
    np.testing.assert_allclose(held.traces * np.reshape(held.scale, (-1, 1)), lines(*held.positions.T), atol=1e-3)
    assert held.aperture == pytest.approx(4e-3)
