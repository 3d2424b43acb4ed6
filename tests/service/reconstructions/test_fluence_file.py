"""Fluence maps in HDF5 and NIfTI, as Steradian and as other programs write them."""

import json

import h5py
import numpy as np
import pytest

from steradian import Volume
from steradian.core.exceptions import DamagedFile, InvalidInput, NotFound
from steradian.imaging import VoxelAxes
from steradian.reconstructions.fluence_file import read_fluence_map
from steradian.reconstructions.series.frames import SeriesFrame
from steradian.reconstructions.series.series import Series
from steradian.spectroscopy import ExponentialFluence, chromophore
from support.commands import run_here

LIGHT = (750e-9, 850e-9)
AXES = VoxelAxes(np.arange(-8, 8) * 1e-4, np.arange(-6, 6) * 1e-4, 1e-3 + np.arange(20) * 5e-5)
SPACING = (1e-4, 1e-4, 5e-5)
MODEL = ExponentialFluence((900.0, 300.0))
TRUE = np.broadcast_to(MODEL.relative(np.array(LIGHT), AXES), (2, 16, 12, 20)).copy()
SATURATION = 0.7


def _series(values):
    frames = [SeriesFrame((n,), light) for n, light in enumerate(LIGHT)]
    return Series(frames, lambda n: Volume(values[n].astype(np.float32), AXES, SPACING, 1500.0))


def _write(folder, kind):
    path = folder / f"map.{'nii.gz' if 'nifti' in kind else 'h5'}"
    if kind == "series":
        _series(TRUE).save(path)
    elif kind == "exported nifti":
        _series(TRUE).save(path)
    elif kind == "flipped nifti":
        import nibabel

        affine = np.diag([-0.1, 0.1, 0.05, 1])
        affine[:3, 3] = [0.7, -0.6, 1.0]
        image = nibabel.Nifti1Image(np.moveaxis(TRUE, 0, -1)[::-1], affine)
        nibabel.save(image, path)
    else:
        with h5py.File(path, "w") as file:
            if kind == "datasets":
                for light, values in zip(LIGHT, TRUE, strict=True):
                    file[f"{1e9 * light:.0f}nm"] = values
            else:
                file["fluence"], file["wavelength_nm"] = TRUE[::-1], [850.0, 750.0]
                for name in "xyz":
                    file[name] = getattr(AXES, name)
    return path


@pytest.mark.parametrize("kind", ["series", "exported nifti", "flipped nifti", "datasets", "array"])
def test_map_is_read_with_its_wavelengths_and_voxels(tmp_path, kind):
    stated = {"wavelengths": LIGHT} if kind == "flipped nifti" else {}
    found = read_fluence_map(_write(tmp_path, kind), **stated)
    np.testing.assert_allclose(found.relative(np.array(LIGHT), AXES), TRUE, rtol=1e-4)
    np.testing.assert_allclose(found.relative(np.array(LIGHT[:1]), AXES), TRUE[:1], rtol=1e-4)


def test_volume_is_the_fluence_at_all_wavelengths(tmp_path):
    Volume(TRUE[0].astype(np.float32), AXES, SPACING).save(tmp_path / "volume.h5")
    found = read_fluence_map(tmp_path / "volume.h5").relative(np.array(LIGHT), AXES)
    np.testing.assert_allclose(np.broadcast_to(found, TRUE.shape)[1], TRUE[0], rtol=1e-6)


def _save_vessel(path):
    """Save a series of a vessel in little noise."""
    spectra = np.column_stack([chromophore(name).at(LIGHT) for name in ("HbO2", "Hb")])
    colours = spectra @ [SATURATION, 1 - SATURATION]
    values = np.zeros(TRUE.shape)
    values[:, 6:10] = (colours[:, None, None, None] * TRUE)[:, 6:10]
    values += 1e-3 * values.max() * np.random.default_rng(0).standard_normal(values.shape)
    _series(values).save(path)


def test_unmix_command_takes_a_map(tmp_path):
    _save_vessel(tmp_path / "series.h5")
    path = _write(tmp_path, "exported nifti")
    run_here("unmix", "series.h5", "--fluence", path.name, "-o", "so2", cwd=tmp_path)
    report = json.loads((tmp_path / "so2" / "report.json").read_text())
    assert report["fluence"]["name"] == "FluenceMap"
    assert report["saturation"]["mean"] == pytest.approx(SATURATION, abs=0.01)


def test_unmix_command_iterates_and_refuses_other_words(tmp_path):
    _save_vessel(tmp_path / "series.h5")
    told = run_here("unmix", "series.h5", "--fluence", "iterate", "-o", "again", cwd=tmp_path)
    assert "fluence iterated in" in " ".join(told.split())
    told = run_here("unmix", "series.h5", "--fluence", "laser", "-o", "none", cwd=tmp_path, code=2)
    assert "fluence is laser; allowed: none, uniform, tissue, fit, iterate, or a file" in " ".join(told.split())


def test_maps_that_do_not_say_enough_are_refused(tmp_path):
    path = _write(tmp_path, "flipped nifti")
    with pytest.raises(InvalidInput, match="2 maps without wavelengths"):
        read_fluence_map(path)
    with pytest.raises(InvalidInput, match="2 maps for 3 wavelengths"):
        read_fluence_map(path, wavelengths=(*LIGHT, 900e-9))
    with h5py.File(tmp_path / "none.h5", "w") as file:
        file["light"] = [1.0]
    with pytest.raises(DamagedFile, match="no dataset values, fluence or 750nm"):
        read_fluence_map(tmp_path / "none.h5")
    with pytest.raises(NotFound):
        read_fluence_map(tmp_path / "missing.h5")
    (tmp_path / "bad.nii").write_bytes(b"no image")
    with pytest.raises(DamagedFile, match="cannot be read as NIfTI"):
        read_fluence_map(tmp_path / "bad.nii")
    (tmp_path / "map.csv").touch()
    with pytest.raises(InvalidInput, match=r"fluence is map\.csv"):
        read_fluence_map(tmp_path / "map.csv")
