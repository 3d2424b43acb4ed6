"""Series in formats of other programs, read back by readers that nobody here wrote."""

import json
import shutil
import subprocess

import h5py
import numpy as np
import pytest

import steradian
from steradian.core.exceptions import Cancelled, Conflict, DamagedFile, InvalidInput, NotFound
from steradian.imaging import Volume, VoxelAxes
from steradian.reconstructions.exporting.series import export_series
from steradian.reconstructions.series.frames import SeriesFrame
from steradian.reconstructions.series.series import Series
from support.commands import run_here

SHAPE, SPACING, ORIGIN = (8, 6, 70), (60e-6, 80e-6, 12e-6), (-0.2e-3, -0.3e-3, 1.2e-3)
LIGHTS = (750e-9, 850e-9)
REGULAR = [SeriesFrame((n,), LIGHTS[n % 2], 0.5 * n) for n in range(6)]
"""Two wavelengths in turn, three times, one each half second."""
RAGGED = REGULAR[:3]


def _volume(number):
    lines = [first + step * np.arange(count) for first, step, count in zip(ORIGIN, SPACING, SHAPE, strict=True)]
    values = np.random.default_rng(number).normal(size=SHAPE).astype(np.float32)
    return Volume(values, VoxelAxes(*lines), SPACING, 1500.0)


def _saved(folder, frames):
    path = folder / "series.h5"
    Series(frames, _volume).save(path)
    return path


@pytest.fixture(scope="module")
def series(tmp_path_factory):
    return _saved(tmp_path_factory.mktemp("regular"), REGULAR)


@pytest.fixture(scope="module")
def ragged(tmp_path_factory):
    return _saved(tmp_path_factory.mktemp("ragged"), RAGGED)


EXPECTED = np.stack([_volume(n).values for n in range(6)])
"""Values [frame, x, y, z]."""


def test_series_as_nifti_is_read_by_nibabel(tmp_path, series):
    import nibabel

    for name in ("a.nii", "a.nii.gz"):
        image = nibabel.load(export_series(series, tmp_path / name, format="nifti"))
        np.testing.assert_array_equal(np.asarray(image.dataobj), np.moveaxis(EXPECTED, 0, -1))
        assert image.header.get_xyzt_units() == ("mm", "sec")
        np.testing.assert_allclose(image.header.get_zooms()[:3], 1e3 * np.array(SPACING), rtol=1e-6)
        np.testing.assert_allclose(image.affine[:3, 3], 1e3 * np.array(ORIGIN), rtol=1e-6)
        assert b"750,850 nm, 6 frames" in bytes(image.header["descrip"])
        (extension,) = image.header.extensions
        said = json.loads(bytes(extension.get_content()).rstrip(b"\0"))
        assert said["FrameTimesStart"] == [0, 0.5, 1, 1.5, 2, 2.5]
        assert said["ExcitationWavelength"] == pytest.approx([750, 850] * 3)
    assert not (tmp_path / "a.json").exists()


def test_nifti_of_one_wavelength_has_the_time_between_volumes(tmp_path):
    import nibabel

    path = _saved(tmp_path, REGULAR[::2])
    image = nibabel.load(export_series(path, tmp_path / "a.nii", format="nifti", sidecar=True))
    assert image.header.get_zooms()[3] == pytest.approx(1.0)
    assert json.loads((tmp_path / "a.json").read_text())["ScanFrames"] == [[0], [2], [4]]


def test_series_as_tiff_is_an_imagej_hyperstack(tmp_path, series):
    import tifffile

    path = export_series(series, tmp_path / "a.tif", format="tiff")
    with tifffile.TiffFile(path) as file:
        assert file.is_imagej
        assert file.series[0].axes == "TZCYX"
        found, said = file.asarray(), file.imagej_metadata
    grid = EXPECTED.reshape(3, 2, *SHAPE)
    np.testing.assert_array_equal(found, grid.transpose(0, 4, 1, 3, 2))
    assert (said["frames"], said["slices"], said["channels"]) == (3, SHAPE[2], 2)
    assert said["finterval"] == pytest.approx(1.0)
    assert said["spacing"] == pytest.approx(12)
    assert said["Labels"][:3] == ["750 nm, 0 s", "850 nm, 0.5 s", "750 nm, 0 s"]
    assert len(said["Labels"]) == 6 * SHAPE[2]
    assert json.loads(said["Info"])["ExcitationWavelength"] == pytest.approx([750, 850] * 3)


def test_series_as_ome_zarr_has_time_and_channel_axes(tmp_path, series):
    import zarr

    path = export_series(series, tmp_path / "a.ome.zarr", format="ome-zarr")
    said = json.loads((path / ".zattrs").read_text())
    (image,) = said["multiscales"]
    assert [(axis["name"], axis["type"]) for axis in image["axes"]] == [
        ("t", "time"), ("c", "channel"), ("z", "space"), ("y", "space"), ("x", "space"),
    ]  # fmt: skip
    assert image["axes"][0]["unit"] == "second"
    scale, translation = image["datasets"][0]["coordinateTransformations"]
    np.testing.assert_allclose(scale["scale"], [1.0, 1.0, 12, 80, 60])
    np.testing.assert_allclose(translation["translation"], [0, 0, 1200, -300, -200])
    assert [channel["label"] for channel in said["omero"]["channels"]] == ["750 nm", "850 nm"]
    assert said["omero"]["channels"][1]["window"]["max"] == pytest.approx(EXPECTED[1::2].max())
    array = zarr.open_group(path, mode="r")["0"]
    np.testing.assert_array_equal(array[:], EXPECTED.reshape(3, 2, *SHAPE).transpose(0, 1, 4, 3, 2))
    assert array.chunks[:2] == (1, 1)


def test_ragged_series_as_ome_zarr_has_a_channel_for_each_frame(tmp_path, ragged):
    import zarr

    path = export_series(ragged, tmp_path / "a.zarr", format="ome-zarr")
    said = json.loads((path / ".zattrs").read_text())
    assert [axis["name"] for axis in said["multiscales"][0]["axes"]] == ["c", "z", "y", "x"]
    names = [channel["label"] for channel in said["omero"]["channels"]]
    assert names == ["750 nm, frame 0", "850 nm, frame 1", "750 nm, frame 2"]
    np.testing.assert_array_equal(zarr.open_group(path, mode="r")["0"][:], EXPECTED[:3].transpose(0, 3, 2, 1))


def test_ragged_series_as_tiff_has_one_time(tmp_path, ragged):
    import tifffile

    found = tifffile.imread(export_series(ragged, tmp_path / "a.tif", format="tiff"))
    np.testing.assert_array_equal(found, EXPECTED[:3].transpose(3, 0, 2, 1))


def test_series_as_plain_hdf5_has_one_dataset_with_wavelengths_and_times(tmp_path, series):
    with h5py.File(export_series(series, tmp_path / "a.h5", format="hdf5")) as file:
        np.testing.assert_array_equal(file["values"][:], EXPECTED)
        np.testing.assert_allclose(file["excitation_m"][:], LIGHTS * 3)
        np.testing.assert_allclose(file["time_s"][:], 0.5 * np.arange(6))
        np.testing.assert_allclose(file["values"].dims[3]["z"][:], _volume(0).axes.z)
        np.testing.assert_allclose(file["spacing_m"][:], SPACING)


def test_plain_hdf5_of_a_series_is_read_by_octave(tmp_path, series):
    program = shutil.which("octave")
    if program is None:
        pytest.skip("needs Octave: apt-get install octave (or dnf, brew install octave)")
    export_series(series, tmp_path / "a.h5", format="hdf5")
    code = "s = load('-hdf5', 'a.h5'); printf('%.9g ', size(s.values), s.excitation_m, s.time_s, s.values(3, 2, 1, 5));"
    done = subprocess.run(
        [program, "--no-gui", "--quiet", "--eval", code], cwd=tmp_path, check=True, capture_output=True, text=True
    )
    told = np.array(done.stdout.split(), float)
    np.testing.assert_allclose(
        told, [*SHAPE[::-1], 6, *LIGHTS * 3, *0.5 * np.arange(6), EXPECTED[4, 0, 1, 2]], rtol=1e-6
    )


def test_series_saves_itself_by_the_ending_of_the_name(tmp_path, series):
    import nibabel

    steradian.open(series).at(850e-9).save(tmp_path / "one.nii")
    np.testing.assert_array_equal(np.asarray(nibabel.load(tmp_path / "one.nii").dataobj)[..., 1], EXPECTED[3])


def test_series_export_reads_slabs_and_reports_each_volume(tmp_path, series, monkeypatch):
    from steradian.reconstructions.exporting import source

    monkeypatch.setattr(source, "SLAB_BYTES", 1)
    seen = []
    export_series(series, tmp_path / "a.nii", format="nifti", progress=lambda *told: seen.append(told))
    assert seen[0] == ("volume 1 of 6, depths", 70, 70)
    assert seen[-1][0] == "volume 6 of 6, depths"


def test_cancelled_series_export_leaves_nothing(tmp_path, series):
    for number, format in enumerate(("nifti", "tiff", "ome-zarr", "hdf5")):
        with pytest.raises(Cancelled):
            export_series(series, tmp_path / f"{number}.nii", format=format, cancelled=lambda: True)
    assert list(tmp_path.iterdir()) == []


def test_series_export_refuses_with_field_and_range(tmp_path, series):
    with pytest.raises(InvalidInput, match="format is nrrd; allowed: hdf5, nifti, tiff, ome-zarr for a series"):
        export_series(series, tmp_path / "a.nrrd", format="nrrd")
    with pytest.raises(NotFound):
        export_series(tmp_path / "none.h5", tmp_path / "a.nii", format="nifti")
    with pytest.raises(Conflict):
        export_series(series, tmp_path, format="nifti")
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file.attrs["format"] = "steradian-volume"
    with pytest.raises(DamagedFile, match="expected 'steradian-series'"):
        export_series(tmp_path / "b.h5", tmp_path / "a.nii", format="nifti")


def test_too_large_hyperstack_is_refused(tmp_path, series, monkeypatch):
    from steradian.reconstructions.exporting import tiff

    monkeypatch.setattr(tiff, "MOST_BYTES", 4 * 6 * 8 * 6 * 70 - 1)
    with pytest.raises(InvalidInput, match=r"6 × \(8, 6, 70\) voxels.*take ome-zarr or nifti"):
        export_series(series, tmp_path / "a.tif", format="tiff")


def test_export_command_writes_series_of_a_folder_and_its_sidecar(tmp_path, series):
    import nibabel

    run_here("export", series.parent, "-o", "a.nii.gz", cwd=tmp_path)
    assert nibabel.load(tmp_path / "a.nii.gz").shape == (*SHAPE, 6)
    assert json.loads((tmp_path / "a.json").read_text())["ExcitationWavelengthUnits"] == "nm"
    told = run_here("export", series, cwd=tmp_path, code=2)
    assert "destination is missing" in " ".join(told.split())
