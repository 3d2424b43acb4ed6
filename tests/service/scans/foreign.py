"""One recording written as every kind of file that can be imported, each by the rules of its own format.

Sensors on a grid that differs in count and pitch along x and y, and one ball off every axis: a swapped, mirrored or
wrongly scaled axis gives other A-lines than the ball's pressure at the imported positions.
"""

import json
import shutil
import subprocess

import h5py
import numpy as np

from fabry_perot.simulator.phantoms import Balls, pressure

SPEED, DT, SAMPLES = 1480.0, 2e-8, 128
COUNTS, PITCH = (12, 8), (0.2e-3, 0.3e-3)
BALL = Balls(np.array([[0.4e-3, -0.7e-3, 1.5e-3]]), np.array([120e-6]), np.array([1.0]))


def expected(positions, first=0.0):
    """(M, N_t) pressure of the ball at positions on the plane z = 0."""
    return pressure(BALL, np.asarray(positions), first + DT * np.arange(SAMPLES), SPEED)


def grid():
    """(M, 2) positions, x slowest, sensor j of n at (j − n//2)·pitch."""
    x, y = ((np.arange(n) - n // 2) * step for n, step in zip(COUNTS, PITCH, strict=True))
    return np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)


def describe(folder, **fields):
    path = folder / "description.json"
    path.write_text(json.dumps(fields))
    return path


def npy_time_first(folder):
    np.save(folder / "traces.npy", np.ascontiguousarray(expected(grid()).T))
    about = {"sampling_interval": 20, "times": "ns", "sound_speed": SPEED, "axes": "time, point", "lengths": "um"}
    return folder / "traces.npy", describe(folder, grid={"count": COUNTS, "interval": [200, 300]}, **about)


def npy_grid_from_shape(folder):
    np.save(folder / "traces.npy", expected(grid()).reshape(*COUNTS, SAMPLES))
    return folder / "traces.npy", describe(
        folder, sampling_interval=DT, sound_speed=SPEED, grid={"interval": list(PITCH)}
    )


def npy_fortran(folder):
    np.save(folder / "traces.npy", np.asfortranarray(expected(grid())))
    np.savetxt(folder / "where.csv", 1e3 * grid(), delimiter=",", header="x_mm, y_mm", comments="")
    about = {"sampling_interval": DT, "sound_speed": SPEED, "positions": "where.csv", "lengths": "mm"}
    return folder / "traces.npy", describe(folder, **about)


def npz_with_positions(folder):
    shuffled = np.random.default_rng(2).permutation(grid())
    np.savez_compressed(
        folder / "all.npz", traces=expected(shuffled), positions=shuffled, dt=DT, sound_speed=SPEED, aperture=2.4e-3
    )
    return folder / "all.npz", None


def csv(folder):
    np.savetxt(folder / "lines.csv", expected(grid()), delimiter=";", header="an A-line a row")
    return folder / "lines.csv", describe(
        folder, sampling_interval=DT, sound_speed=SPEED, positions=grid().tolist(), aperture=2.4e-3
    )


def csv_time_first(folder):
    np.savetxt(folder / "upload", expected(grid()).T, delimiter=",")
    np.save(folder / "where.npy", grid())
    return folder / "upload", describe(
        folder, sampling_interval=DT, sound_speed=SPEED, positions="where.npy", axes="time, point"
    )


def sgl(folder):
    """x fastest, then y, then time."""
    from sgl_files import write_sgl

    steps = tuple(1e6 * step for step in PITCH)
    lines = expected(grid()).reshape(*COUNTS, SAMPLES).swapaxes(0, 1).reshape(-1, SAMPLES)
    source = write_sgl(folder / "a.sgl", samples=lines, steps=steps, interval=1e9 * DT)
    return source, describe(folder, sound_speed=SPEED)


def _matlab(path, **variables):
    """MATLAB 7.3: HDF5 behind 512 bytes of MATLAB's own, every array's axes reversed."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            value = np.atleast_2d(value)
            stored = file.create_dataset(name, data=value.T, chunks=True, compression="gzip", shuffle=True)
            kind = {"f4": "single", "f8": "double", "u1": "logical"}[value.dtype.str[1:]]
            stored.attrs["MATLAB_class"] = np.bytes_(kind)
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64, HDF5 schema 1.00 .".ljust(124) + b"\x00\x02IM")
    return path


def matlab_positions(folder):
    traces = expected(grid())
    return _matlab(folder / "a.mat", sensor_data=traces, dt=DT, positions=grid(), sound_speed=SPEED), None


def matlab_turned(folder):
    """Kept (time, sensor), and three coordinates: the positions tell which axis is which."""
    where = np.column_stack([grid(), np.full(len(grid()), 1e-3)])
    return _matlab(folder / "a.mat", sensor_data=expected(grid()).T, dt=DT, positions=where, c=SPEED), None


def matlab_structure(folder):
    """k-Wave's ``sensor_data.p``, and a cell of the user's own beside it that is nobody's business."""
    path = _matlab(folder / "a.mat", dt=DT, positions=grid(), c=SPEED)
    with h5py.File(path, "r+") as file:
        file["sensor_data/p"] = expected(grid()).T
        file["sensor_data"].attrs["MATLAB_class"] = np.bytes_("struct")
        file.create_dataset("notes", data=[[file["dt"].ref]], dtype=h5py.ref_dtype)
    return path, None


def matlab_cartesian_mask(folder):
    flat = np.column_stack([np.full(len(grid()), 0.3e-3), grid()]).T  # k-Wave: (coordinate, sensor), depth first
    return _matlab(folder / "a.mat", sensor_data=expected(grid()), dt=DT, mask=flat, c=SPEED), None


def matlab_grid(folder):
    """(x, y, time) as MATLAB shows it, with the pitches only."""
    traces = expected(grid()).reshape(*COUNTS, SAMPLES)
    return _matlab(folder / "a.mat", sensor_data=traces, dt=DT, dx=PITCH[0], dy=PITCH[1], c0=SPEED), None


def matlab_binary_mask(folder):
    mask, order = _kwave_mask()
    steps = {"dx": 5e-5, "dy": PITCH[0], "dz": PITCH[1]}
    traces = expected(grid())[order].astype(np.float64)
    return _matlab(folder / "a.mat", sensor_data=traces, mask=mask.astype("u1"), dt=DT, c=SPEED, **steps), None


def _octave(folder, option, more="0"):
    """What Octave itself saves; None where there is no Octave."""
    program = shutil.which("octave")
    if program is None:
        return None
    np.savetxt(folder / "traces.txt", expected(grid()))
    np.savetxt(folder / "where.txt", grid())
    known = f"sensor_data=load('traces.txt'); positions=load('where.txt'); dt={DT}; c={SPEED}"
    code = f"{known}; {more}; save {option} out.x"
    subprocess.run([program, "--no-gui", "--quiet", "--eval", code], cwd=folder, check=True, capture_output=True)
    return folder / "out.x", None


def octave(folder):
    return _octave(folder, "-hdf5")


def octave_6(folder):
    """MATLAB's format of versions 5 and 6, beside a cell, a text and a structure of the user's own."""
    return _octave(folder, "-v6", "notes={1, 'a'}; name='film'; about.when=3")


def octave_7(folder):
    """The same, compressed: what MATLAB's ``save`` writes by default."""
    return _octave(folder, "-v7", "notes={1, 'a'}; sensor_data=single(sensor_data)")


def octave_7_grid(folder):
    """(x, y, time) with the pitches only."""
    fold = (
        f"sensor_data=permute(reshape(sensor_data.', [{SAMPLES} {COUNTS[1]} {COUNTS[0]}]), [3 2 1]); clear positions;"
    )
    return _octave(folder, "-v7", f"{fold} dx={PITCH[0]}; dy={PITCH[1]};")


def matlab_5(folder):
    """By SciPy, where Octave is not at hand."""
    from scipy.io import savemat

    about = {"sensor_data": expected(grid()), "positions": grid(), "dt": DT, "sound_speed": SPEED}
    savemat(folder / "a.mat", about, do_compression=True)
    return folder / "a.mat", None


def _kwave_mask():
    """Mask [x, y, z] in a larger grid, and the order of k-Wave's sensors among ours: its y runs faster than its z."""
    mask = np.zeros((10, 16, 12), bool)
    y, z = (np.arange(n) - n // 2 + side // 2 for n, side in zip(COUNTS, (16, 12), strict=True))
    mask[3, y[:, None], z] = True
    return mask, np.arange(len(grid())).reshape(COUNTS).T.ravel()


def _kwave_file(path, *, kind, steps, **datasets):
    """A k-Wave file: three-dimensional datasets with axes reversed, grid and file type always there."""
    scalars = {"Nx": 10, "Ny": 16, "Nz": 12, "Nt": SAMPLES, "dt": DT} | dict(
        zip(("dx", "dy", "dz"), steps, strict=True)
    )
    with h5py.File(path, "w") as file:
        file.attrs["file_type"], file.attrs["created_by"] = np.bytes_(kind), np.bytes_("kspaceFirstOrder")
        for name, value in scalars.items():
            stored = np.uint64(value) if isinstance(value, int) else np.float32(value)
            file.create_dataset(name, data=np.full((1, 1, 1), stored))
        for name, value in datasets.items():
            chunks = (1, 1, value.shape[2]) if name == "p" else None
            file.create_dataset(name, data=value, chunks=chunks, compression="gzip" if chunks else None)
    return path


STEPS = (5e-5, *PITCH)


def _indices(mask):
    return (np.flatnonzero(mask.ravel(order="F")) + 1).astype(np.uint64).reshape(1, 1, -1)


def kwave_index_mask(folder):
    mask, order = _kwave_mask()
    recorded = expected(grid())[order].T[None]
    path = folder / "output.h5"
    _kwave_file(path, kind="output", steps=STEPS, p=recorded, sensor_mask_index=_indices(mask))
    return path, describe(folder, sound_speed=SPEED)


def kwave_with_input_file(folder):
    mask, order = _kwave_mask()
    _kwave_file(folder / "output.h5", kind="output", steps=STEPS, p=expected(grid())[order].T[None])
    speeds = {"c0": np.full((1, 1, 1), np.float32(SPEED)), "sensor_mask_index": _indices(mask)}
    _kwave_file(folder / "input.h5", kind="input", steps=STEPS, **speeds)
    return folder / "output.h5", describe(folder, positions="input.h5")


def kwave_cuboid(folder):
    mask, _ = _kwave_mask()
    places = np.argwhere(mask)
    corners = np.concatenate([places.min(axis=0), places.max(axis=0)]).astype(np.uint64) + 1
    path = folder / "output.h5"
    _kwave_file(path, kind="output", steps=STEPS, sensor_mask_corners=corners.reshape(1, 6, 1))
    with h5py.File(path, "r+") as file:
        cuboid = expected(grid()).T.reshape(SAMPLES, *COUNTS).swapaxes(1, 2)[..., None]  # (time, z, y, x)
        file.create_dataset("p/1", data=cuboid, chunks=(1, *cuboid.shape[1:]), compression="gzip")
    return path, describe(folder, sound_speed=SPEED)


def ipasc_by_pacfish(folder, *, wavelengths=1, frames=1):
    """A file written by the consortium's own library, its detectors away from the origin and not at z = 0."""
    import pacfish

    device = pacfish.DeviceMetaDataCreator()
    shift = np.array([5e-3, 7e-3, 2e-3])
    device.set_general_information(uuid="a device", fov=np.array([0, 1, 0, 2, 0, 3]) * 1e-3)
    for point in grid():
        element = pacfish.DetectionElementCreator()
        element.set_detector_position(np.array([*point, 0.0]) + shift)
        device.add_detection_element(element.get_dictionary())
    series = expected(grid())[:, :, None, None] * np.ones((wavelengths, frames), np.float32)
    series *= 1 + np.arange(wavelengths)[:, None] + 10 * np.arange(frames)
    tags = pacfish.MetadataAcquisitionTags
    about = {
        tags.UUID.tag: "u",
        tags.ENCODING.tag: "raw",
        tags.COMPRESSION.tag: "raw",
        tags.DATA_TYPE.tag: "float",
        tags.DIMENSIONALITY.tag: "time",
        tags.SIZES.tag: np.array(series.shape),
        tags.AD_SAMPLING_RATE.tag: 1 / DT,
        tags.SPEED_OF_SOUND.tag: SPEED,
        tags.ACQUISITION_WAVELENGTHS.tag: np.array([700e-9, 800e-9, 900e-9])[:wavelengths],
    }
    data = pacfish.PAData(series, about, device.finalize_device_meta_data())
    pacfish.write_data(str(folder / "ipasc.hdf5"), data)
    return folder / "ipasc.hdf5", None


def own_scan(folder):
    """A scan file of ours with samples in float32."""
    from steradian.scans.importing import import_scan

    path = folder / "own.h5"
    import_scan(npz_with_positions(folder)[0], path)
    return path, None


WRITERS = [
    npy_time_first,
    npy_grid_from_shape,
    npy_fortran,
    npz_with_positions,
    csv,
    csv_time_first,
    sgl,
    matlab_positions,
    matlab_turned,
    matlab_structure,
    matlab_cartesian_mask,
    matlab_grid,
    matlab_binary_mask,
    matlab_5,
    octave,
    octave_6,
    octave_7,
    octave_7_grid,
    kwave_index_mask,
    kwave_with_input_file,
    kwave_cuboid,
    ipasc_by_pacfish,
    own_scan,
]
