"""The time of the first sample, as files and descriptions state it: one, one a sensor, none, or in another unit."""

import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
import foreign

from steradian.core.exceptions import InvalidInput
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.run import reconstruct_in_memory
from steradian.scans.importing import import_scan
from steradian.scans.importing.inspect import inspect_recording
from steradian.scans.opening import open_recording

LATE = 0.9e-6
DEPTH = foreign.BALL.centres[0, 2]
ALLOWED = r"at least -0\.0005, at most 0\.0005 \(s\); "
A_FILE_S = f"{ALLOWED}numbers of a file count as s"


def _npz(path, **arrays):
    np.savez(path.with_suffix(".npz"), **arrays)
    return path.with_suffix(".npz")


def _mat5(path, **arrays):
    from scipy.io import savemat

    savemat(path.with_suffix(".mat"), arrays)
    return path.with_suffix(".mat")


def _mat7(path, **arrays):
    return foreign._matlab(path.with_suffix(".mat"), **arrays)


def _recorded(begins=0.0):
    points = foreign.grid()
    traces = foreign.expected(points, begins)
    return {"sensor_data": traces, "positions": points, "dt": foreign.DT, "c": foreign.SPEED}


WRITERS = pytest.mark.parametrize("write", [_npz, _mat5, _mat7])


def _depth_of_the_ball(recording):
    volume = reconstruct_in_memory(recording, ReconstructionParameters.create(modes=24))
    return volume.axes.z[np.unravel_index(volume.values.argmax(), volume.values.shape)[-1]]


@WRITERS
def test_late_file_has_its_ball_at_its_depth(tmp_path, write):
    recording = open_recording(write(tmp_path / "a", t0=LATE, **_recorded(LATE)))
    assert recording.time_zero == LATE
    assert _depth_of_the_ball(recording) == pytest.approx(DEPTH, abs=foreign.DT * foreign.SPEED)


def test_late_kwave_file_has_its_ball_at_its_depth(tmp_path):
    source, description = foreign.kwave_index_mask(tmp_path)
    with h5py.File(source, "r+") as file:
        _, order = foreign._kwave_mask()
        file["p"][...] = foreign.expected(foreign.grid(), 45 * foreign.DT)[order].T[None]
        file["Nt"][...] = foreign.SAMPLES + 45
    import_scan(source, tmp_path / "kwave" / "scan.h5", description=description)
    recording = open_recording(tmp_path / "kwave" / "scan.h5")
    assert recording.time_zero == pytest.approx(45 * foreign.DT)
    assert _depth_of_the_ball(recording) == pytest.approx(DEPTH, abs=foreign.DT * foreign.SPEED)


@WRITERS
@pytest.mark.parametrize("shape", [(-1,), (1, -1), (-1, 1)], ids=["list", "row", "column"])
def test_time_zeros_of_each_sensor_may_be_a_row_or_a_column(tmp_path, write, shape):
    zeros = 1e-8 * np.arange(len(foreign.grid()))
    recording = open_recording(write(tmp_path / "a", t0=zeros.reshape(shape), **_recorded()))
    np.testing.assert_allclose(recording.shots.time_zero, zeros)


@pytest.mark.parametrize("write", [_mat5, _mat7])
def test_empty_time_zero_of_matlab_is_not_given(tmp_path, write):
    path = write(tmp_path / "a", **(_recorded() | ({} if write is _mat7 else {"t0": np.zeros((0, 0))})))
    if write is _mat7:  # MATLAB keeps the size of [] in place of its numbers
        with h5py.File(path, "r+") as file:
            file["t0"] = np.zeros(2, np.uint64)
            file["t0"].attrs["MATLAB_class"], file["t0"].attrs["MATLAB_empty"] = np.bytes_("double"), np.uint8(1)
    assert open_recording(path).time_zero == 0
    assert inspect_recording(path).time_zero == 0


@WRITERS
@pytest.mark.parametrize("wrong", [0.5, -0.5, 500.0])
def test_time_zero_in_another_unit_is_refused_like_a_sampling_interval(tmp_path, write, wrong):
    path = write(tmp_path / "a", t0=wrong, **_recorded())
    with pytest.raises(InvalidInput, match=f"time_zero is {wrong:g} s; allowed: {A_FILE_S}"):
        open_recording(path)
    each = np.full(len(foreign.grid()), 1e-7)
    each[5] = wrong
    with pytest.raises(InvalidInput, match=f"time_zero is {wrong:g} s; allowed: {ALLOWED}"):
        open_recording(write(tmp_path / "b", t0=each, **_recorded()))


def test_description_s_time_zero_may_be_in_its_unit_and_is_refused_in_its_words(tmp_path):
    path = _npz(tmp_path / "a", t0=0.5, **_recorded())
    stated = foreign.describe(tmp_path, time_zero=0.5, times="us")
    import_scan(path, tmp_path / "out" / "scan.h5", description=stated)
    assert open_recording(tmp_path / "out" / "scan.h5").time_zero == pytest.approx(0.5e-6)
    stated = foreign.describe(tmp_path, time_zero=0.5)
    with pytest.raises(InvalidInput, match=rf'time_zero is 0\.5 s; allowed: {ALLOWED}.*"times": "us" or "ns"'):
        import_scan(path, tmp_path / "b" / "scan.h5", description=stated)
