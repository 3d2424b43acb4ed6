"""``steradian import`` and ``steradian export``: what they make, and how they refuse."""

import json

import h5py
import numpy as np
import pytest

import steradian
from fabry_perot.simulator.phantoms import Balls, pressure
from steradian.scans.opening import open_recording
from support.commands import run_here as run
from support.recordings import DEPTH, INTERVAL, SOUND_SPEED, ball

BALL = Balls(np.array([[0.4e-3, -0.7e-3, 1.5e-3]]), np.array([150e-6]), np.array([1.0]))


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    """A CSV of A-lines, imported, reconstructed and exported again."""
    folder = tmp_path_factory.mktemp("walk")
    line = (np.arange(16) - 8) * 0.2e-3
    positions = np.stack(np.meshgrid(line, line, indexing="ij"), -1).reshape(-1, 2)
    np.savetxt(folder / "lines.csv", pressure(BALL, positions, 2e-8 * np.arange(128), 1500.0), delimiter=",")
    about = {"sampling_interval": 20, "times": "ns", "lengths": "mm", "sound_speed": 1500}
    about["grid"] = {"count": [16, 16], "interval": [0.2, 0.2]}
    (folder / "about.json").write_text(json.dumps(about))
    run("import", "lines.csv", "scan.h5", "--description", "about.json", cwd=folder)
    run("reconstruct", "scan.h5", "--modes", "16", "--output", "out", cwd=folder)
    return folder


@pytest.mark.long
def test_a_recording_goes_from_csv_to_nrrd(walk):
    """The ball of the CSV lies in the exported volume where it was, in millimetres."""
    import nrrd

    run("export", "out/volume.h5", "ball.nrrd", cwd=walk)
    values, header = nrrd.read(str(walk / "ball.nrrd"))
    steps = np.diag(header["space directions"])
    place = header["space origin"] + steps * np.unravel_index(values.argmax(), values.shape)
    np.testing.assert_allclose(place, 1e3 * BALL.centres[0], atol=0.15)


@pytest.mark.long
def test_a_scan_is_exported_as_ipasc_and_imported_again(walk):
    """A scan needs no format: it becomes IPASC, and comes back with the same samples."""
    run("export", "scan.h5", "ipasc.hdf5", cwd=walk)
    assert "ipasc" in run("import", "ipasc.hdf5", "back.h5", cwd=walk)
    with h5py.File(walk / "scan.h5") as old, h5py.File(walk / "back.h5") as new:
        np.testing.assert_array_equal(old["alines/samples"], new["alines/samples"])


@pytest.mark.long
def test_import_of_kwave_p_without_mask_says_what_places_the_sensors_and_takes_a_grid(tmp_path):
    x = 0.2e-3 * (np.arange(12) - 6)
    places = np.stack(np.meshgrid(x, x, indexing="ij"), -1).reshape(-1, 2)
    lines = pressure(BALL, places, 2e-8 * np.arange(128), 1500.0)
    np.savez(tmp_path / "recording.npz", p=lines.T, dt=2e-8, c0=1500)
    told = " ".join(run("import", "recording.npz", "scan.h5", cwd=tmp_path, code=2).split())
    assert "beside p k-Wave's sensor mask as mask, with its pitch dx, or positions" in told
    assert "grid (interval, count)" in told
    grid = '{"grid": {"count": [12, 12], "interval": [2e-4, 2e-4]}}'
    run("import", "recording.npz", "scan.h5", "--description", grid, cwd=tmp_path)
    np.testing.assert_allclose(open_recording(tmp_path / "scan.h5").positions, places, atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["import", "none.csv", "new.h5"], 3, ["none.csv"]),
        (["import", "lines.csv", "new.h5"], 2, ["positions", "description"]),
        (["import", "lines.csv", "scan.h5", "--description", "about.json"], 4, ["exists"]),
        (["import", "about.json", "new.h5"], 3, ["neither HDF5"]),
        (["export", "out/volume.h5", "ball.dicom"], 2, ["format", "nrrd"]),
        (["export", "out/volume.h5", "pngs"], 2, ["pngs", "-f hdf5|", "|png,", ".nrrd"]),
        (["export", "out/volume.h5", "ball", "--format", "dicom"], 2, ["nifti, tiff, ome-zarr"]),
        (["export", "out/volume.h5", "out", "--format", "png"], 4, ["folder that exists"]),
        (["export", "scan.h5", "scan.nrrd", "--format", "nrrd"], 2, ["ipasc"]),
        (["export", "scan.h5", "x.nii.gz"], 2, ["destination is x.nii.gz", ".hdf5, .h5, .sgl", "-f ipasc|sgl"]),
        (["export", "scan.h5", "x"], 2, ["destination is x;", ".hdf5, .h5, .sgl"]),
        (["export", "lines.csv", "ball.nrrd"], 3, ["lines.csv"]),
    ],
)
def test_refusals_are_one_clear_line(walk, arguments, code, words):
    """Each refusal has its exit code and names what and what is allowed."""
    said = " ".join(run(*arguments, cwd=walk, code=code).split())
    for word in words:
        assert word in said


@pytest.mark.long
def test_reconstruct_command_imports_array_with_inline_json_description(tmp_path):
    """One command from somebody's array to an image; lengths and times in the object's own units."""
    traces, positions = ball()
    np.save(tmp_path / "a.npy", traces.T)
    said = {"axes": "time, point", "positions": (1e3 * positions).tolist(), "lengths": "mm", "times": "ns"}
    said |= {"sampling_interval": 1e9 * INTERVAL, "sound_speed": SOUND_SPEED, "time_zero": 0}
    run("reconstruct", "a.npy", "-d", json.dumps(said), "--modes", 24, "-o", "out", cwd=tmp_path)
    volume = steradian.open(tmp_path / "out" / "volume.h5")
    place = np.array(volume.origin) + np.array(volume.spacing) * np.unravel_index(
        volume.values.argmax(), volume.values.shape
    )
    np.testing.assert_allclose(place, (0.3e-3, -0.15e-3, DEPTH), atol=0.6 * max(volume.spacing))
    assert steradian.open(tmp_path / "out" / "scan.h5").stored == 576


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ("{", "description is {; allowed: a JSON object, or the name of a file"),
        ('{"positions": "film.csv"}', "positions is film.csv; allowed: a list here"),
        ('{"delay": 1}', "delay is 1; allowed: only the fields"),
        ("none.json", "there is no file 'none.json'"),
    ],
)
def test_reconstruct_command_refuses_a_description_that_is_none(tmp_path, said, told):
    np.save(tmp_path / "a.npy", np.zeros((4, 4)))
    out = run("reconstruct", "a.npy", "-d", said, cwd=tmp_path, code=3 if "none" in said else 2)
    assert told in " ".join(out.split())
    assert not list(tmp_path.glob("reconstruction/*"))
