"""Volumes in other formats, read back by readers that nobody here wrote.

The phantom has three different extents and voxel sizes and a ball off every axis, so an axis that is swapped, mirrored
or wrongly scaled shows.
"""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from PIL import Image

from steradian.core.exceptions import Cancelled, Conflict, DamagedFile, InvalidInput, NotFound
from steradian.imaging import Volume, VoxelAxes
from steradian.reconstructions.exporting import export_volume
from steradian.reconstructions.volumes.file import read_volume, write_volume
from support.damage import BITS, spoil

SHAPE, SPACING, ORIGIN = (24, 18, 40), (60e-6, 80e-6, 12e-6), (-0.72e-3, -0.6e-3, 1.2e-3)
TOOLS = "pip install --no-deps -r constraints-ci.txt"
BALL = (0.24e-3, -0.28e-3, 1.44e-3)
PLACE = (16, 4, 20)
"""Voxel of the ball's centre."""
FORMATS = {
    "hdf5": "a.h5",
    "nifti": "a.nii.gz",
    "tiff": "a.tif",
    "ome-zarr": "a.ome.zarr",
    "vtkhdf": "a.vtkhdf",
    "nrrd": "a.nrrd",
    "png": "pictures",
}


def _lines(names="xyz"):
    axes = ["xyz".index(name) for name in names]
    return [ORIGIN[axis] + SPACING[axis] * np.arange(SHAPE[axis]) for axis in axes]


@pytest.fixture(scope="module")
def values():
    x, y, z = np.ix_(*_lines())
    square = (x - BALL[0]) ** 2 + (y - BALL[1]) ** 2 + (z - BALL[2]) ** 2
    found = np.exp(-square / 2 / 70e-6**2).astype(np.float32)
    assert np.unravel_index(found.argmax(), SHAPE) == PLACE
    return found


@pytest.fixture(scope="module")
def volume(tmp_path_factory, values):
    path = tmp_path_factory.mktemp("volume") / "volume.h5"
    write_volume(
        path, Volume(values, VoxelAxes(*_lines()), SPACING), parameters={"modes": 24}, provenance={"scan_id": "s1"}
    )
    return path


@pytest.fixture(scope="module")
def image(tmp_path_factory, values):
    """An image [x, z] from a line of sensors."""
    path = tmp_path_factory.mktemp("image") / "image.h5"
    x, z = _lines("xz")
    plane = Volume(values[:, PLACE[1]], VoxelAxes(x, None, z), SPACING[::2])
    write_volume(path, plane, parameters={}, provenance={})
    return path


def test_nifti_by_nibabel(tmp_path, volume, values):
    """Millimetres, and an affine that takes the ball's voxel to its place."""
    import nibabel

    for name in ("a.nii", "a.nii.gz"):
        found = nibabel.load(export_volume(volume, tmp_path / name, format="nifti"))
        np.testing.assert_array_equal(np.asarray(found.dataobj), values)
        assert found.header.get_xyzt_units()[0] == "mm"
        np.testing.assert_allclose(found.header.get_zooms(), 1e3 * np.array(SPACING), rtol=1e-6)
        assert nibabel.aff2axcodes(found.affine) == ("R", "A", "S")
        for affine in (found.affine, found.get_qform()):
            np.testing.assert_allclose((affine @ [*PLACE, 1])[:3], 1e3 * np.array(BALL), rtol=1e-5)


def _vtk(reader, path):
    """Spacing, origin and values [x, y, z] as VTK has them."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    reader.SetFileName(str(path))
    reader.Update()
    found = reader.GetOutput()
    numbers = vtk_to_numpy(found.GetPointData().GetArray(0))
    return found.GetSpacing(), found.GetOrigin(), numbers.reshape(found.GetDimensions(), order="F")


@pytest.mark.long
@pytest.mark.parametrize("format", ["nifti", "nrrd", "vtkhdf"])
def test_voxel_sizes_and_axes_by_vtk(tmp_path, volume, values, format):
    """VTK's own readers find the same voxel sizes in millimetres, and the same axes."""
    pytest.importorskip("vtkmodules", reason=f"needs VTK: {TOOLS}")
    from vtkmodules.vtkIOHDF import vtkHDFReader
    from vtkmodules.vtkIOImage import vtkNIFTIImageReader, vtkNrrdReader

    reader = {"nifti": vtkNIFTIImageReader, "nrrd": vtkNrrdReader, "vtkhdf": vtkHDFReader}[format]()
    spacing, origin, found = _vtk(reader, export_volume(volume, tmp_path / FORMATS[format], format=format))
    np.testing.assert_array_equal(found, values)
    assert reader.GetOutput().GetPointData().GetScalars() is not None  # else a viewer shows an empty box
    np.testing.assert_allclose(spacing, 1e3 * np.array(SPACING), rtol=1e-6)
    if format == "nifti":  # this reader keeps the origin in a matrix of its own
        matrix = reader.GetSFormMatrix() or reader.GetQFormMatrix()
        origin = [matrix.GetElement(axis, 3) for axis in range(3)]
    np.testing.assert_allclose(origin, 1e3 * np.array(ORIGIN), rtol=1e-6)


def test_nrrd_by_pynrrd(tmp_path, volume, values):
    """Sizes, directions, origin and units as pynrrd reads them."""
    import nrrd

    found, header = nrrd.read(str(export_volume(volume, tmp_path / "a.nrrd", format="nrrd")))
    np.testing.assert_array_equal(found, values)
    np.testing.assert_allclose(header["space directions"], 1e3 * np.diag(SPACING))
    np.testing.assert_allclose(header["space origin"], 1e3 * np.array(ORIGIN))
    assert header["space"] == "right-anterior-superior"
    assert header["space units"] == ["mm", "mm", "mm"]


def test_imagej_tiff_by_pillow_and_tifffile(tmp_path, volume, values):
    """Pages are depths, rows y, columns x; resolution, spacing and origin stand where ImageJ looks."""
    import tifffile

    path = export_volume(volume, tmp_path / "a.tif", format="tiff")
    with Image.open(path) as pages:
        assert (pages.n_frames, *pages.size) == (SHAPE[2], SHAPE[0], SHAPE[1])
        np.testing.assert_allclose([1 / float(pages.tag_v2[282]), 1 / float(pages.tag_v2[283])], [60, 80], rtol=1e-6)
        said = dict(line.split("=") for line in pages.tag_v2[270].splitlines())
        pages.seek(PLACE[2])
        np.testing.assert_array_equal(np.array(pages), values[:, :, PLACE[2]].T)
    assert said["unit"] == "micron"
    assert int(said["slices"]) == SHAPE[2]
    steps = [60, 80, float(said["spacing"])]
    origin = [-float(said[f"{axis}origin"]) * step for axis, step in zip("xyz", steps, strict=True)]
    np.testing.assert_allclose(steps, 1e6 * np.array(SPACING))
    np.testing.assert_allclose(origin, 1e6 * np.array(ORIGIN))
    with tifffile.TiffFile(path) as file:
        assert file.is_imagej
        assert file.series[0].axes == "ZYX"
        np.testing.assert_array_equal(file.asarray(), values.T)


@pytest.mark.long
def test_ome_zarr_by_its_text_and_by_zarr(tmp_path, volume, values):
    """Zarr 2 with OME metadata 0.4: axes z, y, x in micrometres, scale and translation."""
    import zarr

    path = export_volume(volume, tmp_path / "a.ome.zarr", format="ome-zarr")
    assert json.loads((path / ".zgroup").read_text())["zarr_format"] == 2
    (said,) = json.loads((path / ".zattrs").read_text())["multiscales"]
    assert said["version"] == "0.4"
    assert [axis["name"] for axis in said["axes"]] == ["z", "y", "x"]
    assert {axis["unit"] for axis in said["axes"]} == {"micrometer"}
    (level,) = said["datasets"]
    scale, translation = level["coordinateTransformations"]
    np.testing.assert_allclose(scale["scale"][::-1], 1e6 * np.array(SPACING))
    np.testing.assert_allclose(translation["translation"][::-1], 1e6 * np.array(ORIGIN))
    stored = json.loads((path / level["path"] / ".zarray").read_text())
    assert stored["dimension_separator"] == "/"
    assert tuple(stored["shape"]) == SHAPE[::-1]
    np.testing.assert_array_equal(zarr.open_group(path, mode="r")[level["path"]][...], values.T)


def test_hdf5_is_a_volume_file_with_coordinates(tmp_path, volume, values):
    """Our own reader takes it; others find numbers only: values, coordinates, voxel size."""
    path = export_volume(volume, tmp_path / "a.h5", format="hdf5")
    found = read_volume(path)
    np.testing.assert_array_equal(found.values, values)
    assert found.spacing == SPACING
    assert found.origin == pytest.approx(ORIGIN)
    with h5py.File(path) as file:
        assert all(data.dtype.kind == "f" for data in file.values())
        for name, line in zip("xyz", _lines(), strict=True):
            np.testing.assert_allclose(file[name], line)


def test_hdf5_by_octave(tmp_path, volume):
    """Octave loads it: axes in the opposite order, the ball where it is, coordinates in metres."""
    program = shutil.which("octave")
    if program is None:
        pytest.skip("needs Octave: apt-get install octave (or dnf, brew install octave)")
    export_volume(volume, tmp_path / "a.h5", format="hdf5")
    code = """
        s = load('-hdf5', 'a.h5'); [~, i] = max(s.values(:)); [z, y, x] = ind2sub(size(s.values), i);
        printf('%.9g ', size(s.values), s.x(x), s.y(y), s.z(z), s.spacing_m);
    """
    command = [program, "--no-gui", "--quiet", "--eval", code]
    done = subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, text=True)
    told = np.array(done.stdout.split(), float)
    np.testing.assert_array_equal(told[:3], SHAPE[::-1])
    np.testing.assert_allclose(told[3:6], BALL, rtol=1e-6)
    np.testing.assert_allclose(told[6:], SPACING)


def test_png_projections_have_the_volumes_proportions(tmp_path, volume):
    """Three pictures in a folder, or the z-projection alone in a file."""
    folder = export_volume(volume, tmp_path / "pictures", format="png")
    assert sorted(path.name for path in folder.iterdir()) == ["mip-x.png", "mip-y.png", "mip-z.png"]
    single = export_volume(volume, tmp_path / "z.png", format="png")
    assert single.read_bytes() == (folder / "mip-z.png").read_bytes()
    with Image.open(single) as picture:
        light = np.asarray(picture.convert("RGB")).astype(int).sum(axis=2)
    dark = light < 60  # the projection, most of which is nothing; letters are lighter
    rows, columns = (np.flatnonzero(dark.mean(axis=side) > 0.3) for side in (1, 0))
    inside = light[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    height, width = inside.shape
    bright = np.argwhere(inside[: int(0.8 * height)] > 600)  # the scale bar is below
    row, column = np.median(bright, axis=0)
    assert width / height == pytest.approx(SHAPE[0] * SPACING[0] / SHAPE[1] / SPACING[1], rel=0.02)
    assert column / width == pytest.approx((PLACE[0] + 0.5) / SHAPE[0], abs=0.05)
    assert row / height == pytest.approx(1 - (PLACE[1] + 0.5) / SHAPE[1], abs=0.05)


@pytest.mark.parametrize("format", FORMATS)
def test_an_image_from_a_line_of_sensors_exports_too(tmp_path, image, format):
    """Two dimensions become one voxel along y."""
    path = export_volume(image, tmp_path / FORMATS[format], format=format)
    assert path.exists()
    if format == "nrrd":
        import nrrd

        found, header = nrrd.read(str(path))
        assert found.shape == (SHAPE[0], 1, SHAPE[2])
        np.testing.assert_allclose(np.diag(header["space directions"]), [0.06, 0.06, 0.012])


@pytest.mark.parametrize("format", FORMATS)
def test_slabs_progress_and_a_stop_that_leaves_nothing(tmp_path, volume, values, format, monkeypatch):
    """A volume passes in slabs, whatever their size; progress ends at the whole; a stop removes the beginnings."""
    monkeypatch.setattr("steradian.reconstructions.exporting.source.SLAB_BYTES", 7 * SHAPE[0] * SHAPE[1] * 4)
    name = FORMATS[format]
    seen = []
    whole = export_volume(volume, tmp_path / "whole" / name, format=format, progress=lambda *told: seen.append(told))
    assert seen[-1][1] == seen[-1][2]
    assert [done for _, done, _ in seen] == sorted({done for _, done, _ in seen})
    with pytest.raises(Cancelled):
        export_volume(volume, tmp_path / "stopped" / name, format=format, cancelled=lambda: True)
    assert list((tmp_path / "stopped").iterdir()) == []
    assert [path.name for path in whole.parent.iterdir()] == [name]
    if format == "nrrd":
        assert whole.read_bytes()[-values.nbytes :] == values.tobytes("F")


def test_a_file_is_replaced_and_a_folder_never(tmp_path, volume):
    """Exporting twice gives the newer file; a folder that is there stays untouched."""
    (tmp_path / "a.nrrd").write_text("old")
    export_volume(volume, tmp_path / "a.nrrd", format="nrrd")
    assert (tmp_path / "a.nrrd").read_bytes().startswith(b"NRRD0005")
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "mine").touch()
    for format in ("png", "ome-zarr", "nrrd"):
        with pytest.raises(Conflict, match="exists"):
            export_volume(volume, tmp_path / "kept", format=format)
    assert (tmp_path / "kept" / "mine").exists()


@pytest.mark.parametrize(("format", "needs"), [("nifti", "nibabel"), ("tiff", "tifffile"), ("ome-zarr", "zarr")])
def test_a_missing_library_is_named_with_its_extra(tmp_path, volume, monkeypatch, format, needs):
    """Without the extra the error says what to install; the other formats need nothing of it."""
    monkeypatch.setitem(sys.modules, needs, None)
    with pytest.raises(InvalidInput, match=rf"{needs}.*pip install 'steradian\[export\]'"):
        export_volume(volume, tmp_path / "a", format=format)
    assert list(tmp_path.iterdir()) == []
    for other in ("hdf5", "nrrd", "vtkhdf", "png"):
        export_volume(volume, tmp_path / FORMATS[other], format=other)


@pytest.mark.parametrize("format", FORMATS)
def test_values_that_cannot_be_read_end_an_export_as_damage_and_leave_nothing(tmp_path, volume, format):
    """Where HDF5 finds no chunk any more, which shows when the first is read."""
    bad, out = tmp_path / "bad.h5", tmp_path / "out"
    whole = volume.read_bytes()
    assert whole.count(b"TREE\x01") > 0
    bad.write_bytes(whole.replace(b"TREE\x01", b"EERT\x01"))
    spoil(bad, "mip_z")  # which has no chunks
    with pytest.raises(DamagedFile, match=r"bad\.h5"):
        export_volume(bad, out / FORMATS[format], format=format)
    assert list(out.iterdir()) == []


@pytest.mark.parametrize("bit", BITS)
def test_export_of_damaged_volume_is_refused_before_writing(tmp_path, volume, bit):
    bad = Path(shutil.copy(volume, tmp_path / "bad.h5"))
    spoil(bad, "values", bit)
    with pytest.raises(DamagedFile, match=r"bad\.h5"):
        export_volume(bad, tmp_path / "out" / "a.nrrd", format="nrrd")
    assert not (tmp_path / "out").exists()


def test_export_of_invalid_volume_or_unknown_format_is_refused(tmp_path, volume):
    """Unknown formats list the known ones; files that are no volumes are named."""
    with pytest.raises(InvalidInput, match="hdf5, nifti, tiff, ome-zarr, vtkhdf, nrrd, png"):
        export_volume(volume, tmp_path / "a", format="dicom")
    with pytest.raises(NotFound):
        export_volume(tmp_path / "none.h5", tmp_path / "a", format="nrrd")
    for content in (b"no hdf5", Path(volume).read_bytes()[:900]):
        (tmp_path / "bad.h5").write_bytes(content)
        with pytest.raises(DamagedFile, match=r"bad\.h5"):
            export_volume(tmp_path / "bad.h5", tmp_path / "a", format="nrrd")
    with h5py.File(tmp_path / "bad.h5", "w") as file:
        file.attrs.update({"format": "steradian-volume", "schema_version": 1})
    with pytest.raises(DamagedFile, match=r"bad\.h5"):
        export_volume(tmp_path / "bad.h5", tmp_path / "a", format="nrrd")
