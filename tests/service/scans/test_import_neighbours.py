"""Property test of imports: an array is read as what it is, or refused, however its program lays it out."""

import sys
from contextlib import nullcontext, suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parent))
import foreign
from test_import_axes import DT, SPEED, plane, sensed
from test_import_matlab_order import by_h5py, by_matlab_7_3, by_scipy

from steradian.core.exceptions import InvalidInput
from steradian.scans.importing import import_scan
from steradian.scans.opening import open_recording


def by_numpy(path, **variables):
    target = path.with_suffix(".npz")
    np.savez(target, **variables)
    return target


LAYOUTS = st.fixed_dictionaries(
    {
        "write": st.sampled_from([by_numpy, by_h5py, by_matlab_7_3, by_scipy]),
        "counts": st.tuples(st.integers(10, 14), st.integers(10, 14)),
        "samples": st.one_of(st.integers(130, 220), st.just("as many as sensors")),
        "turned": st.booleans(),
        "fortran": st.booleans(),
        "dtype": st.sampled_from(["<f4", ">f4", "<f8", ">f8", "<i2", ">i2"]),
        "gaps": st.integers(0, 4),
        "corner": st.tuples(st.floats(-9e-3, 9e-3), st.floats(-9e-3, 9e-3)),
        "scatter": st.sampled_from([0.0, 2e-6]),
        "axes": st.sampled_from([2, 3]),
        "lengths": st.sampled_from(["m", "mm", "um"]),
        "times": st.sampled_from(["s", "us", "ns"]),
        "late": st.sampled_from([0.0, 1e-6, 3e-6]),
        "names": st.sampled_from(["traces dt c0", "sensor_data dt c", "sensor_data sampling_interval sound_speed"]),
    }
)
UNITS = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "s": 1.0, "us": 1e-6, "ns": 1e-9}


@pytest.mark.long
@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(layout=LAYOUTS)
def test_array_of_any_layout_is_read_correctly_or_refused_as_ambiguous(tmp_path_factory, layout):
    folder = tmp_path_factory.mktemp("layout")
    points = plane(*layout["counts"])
    points = np.delete(points, np.linspace(0, len(points) - 1, layout["gaps"]).astype(int), axis=0)
    samples = len(points) if isinstance(layout["samples"], str) else layout["samples"]
    lines = sensed(points, samples=samples)
    if layout["dtype"][1:] == "i2":
        lines = np.round(lines * (20_000 / np.abs(lines).max()))
    lines = lines.astype(layout["dtype"])
    array = lines.T if layout["turned"] else lines
    array = np.asfortranarray(array) if layout["fortran"] else np.ascontiguousarray(array)
    places = points + np.array(layout["corner"])
    if layout["axes"] == 3:
        height = layout["scatter"] * np.random.default_rng(0).uniform(-1, 1, len(places))
        places = np.column_stack([places, height])
    data, interval, speed = layout["names"].split()
    length, time = UNITS[layout["lengths"]], UNITS[layout["times"]]
    stated = {data: array, "positions": places / length, interval: DT / time, speed: SPEED, "t0": layout["late"] / time}
    source = layout["write"](folder / "a", **stated)
    about = foreign.describe(folder, lengths=layout["lengths"], times=layout["times"])
    with suppress(InvalidInput) if samples == len(points) else nullcontext():
        import_scan(source, folder / "scan.h5", description=about)
    if not (folder / "scan.h5").exists():
        return
    recording = open_recording(folder / "scan.h5")
    traces = recording.traces * np.reshape(recording.scale, (-1, 1) if np.ndim(recording.scale) else ())
    np.testing.assert_allclose(traces, lines, rtol=2e-7, atol=1e-6 * np.abs(lines).max())
    centre = np.array(recording.centre or (0, 0))
    np.testing.assert_allclose(recording.positions + centre, places[:, :2], rtol=0, atol=1e-9)
    found = (recording.sampling_interval, recording.sound_speed, recording.time_zero)
    assert found == (pytest.approx(DT), SPEED, pytest.approx(layout["late"], abs=1e-15))
