"""Series of volumes: one result of a scan with several frames, in memory, in a file and from the iterative method."""

import json

import h5py
import numpy as np
import pytest
from PIL import Image

import steradian
from steradian import InvalidInput, Volume
from steradian.core.exceptions import Cancelled, DamagedFile
from steradian.imaging import VoxelAxes
from steradian.quality import Box
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.series.frames import SeriesFrame
from steradian.reconstructions.series.reconstruct import reconstruct_series
from steradian.reconstructions.series.series import Series, read_series
from steradian.spectroscopy import UniformFluence
from support.commands import run_here
from support.series_scan import LIGHTS, MASK, SATURATION, write_scan

FAST = {"modes": 24, "depth_range": (0.6e-3, 1.6e-3)}


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    return write_scan(tmp_path_factory.mktemp("scan") / "scan.h5")


@pytest.fixture(scope="module")
def folder(scan, tmp_path_factory):
    output = tmp_path_factory.mktemp("series")
    report = reconstruct_series(scan, output, ReconstructionParameters.create(**FAST))
    return output, report


def test_series_has_the_volume_of_each_frame_with_its_wavelength(scan, folder):
    series = steradian.open(folder[0])
    assert [each.numbers for each in series.frames] == [(0,), (1,), (2,), (3,)]
    assert series.wavelengths == pytest.approx(LIGHTS)
    for number, volume in enumerate(series):
        alone = steradian.open(scan).reconstruct(frame=number, **FAST)
        np.testing.assert_allclose(volume.values, alone.values, rtol=1e-6)
        np.testing.assert_allclose(volume.axes.z, alone.axes.z)
    assert "4 volumes, 750 nm, 850 nm" in repr(series)


def test_report_states_each_frame_and_what_is_common(folder):
    _, report = folder
    assert [each.excitation_m for each in report.frames] == pytest.approx([750e-9] * 2 + [850e-9] * 2)
    assert report.shape == (24, 24, report.shape[2])
    assert report.frames[0].maximum > 0
    assert all((each.sensors, each.planned) == (MASK.count, MASK.count) for each in report.frames)
    assert report.frames[0].shots.left_out == {}
    assert (folder[0] / "report.json").is_file()


def test_part_wavelength_and_mean_of_a_series_are_its_volumes(folder):
    series = read_series(folder[0] / "series.h5")
    second = series.at(850e-9)
    assert [each.numbers for each in second.frames] == [(2,), (3,)]
    np.testing.assert_allclose(second.mean().values, (series[2].values + series[3].values) / 2, rtol=1e-5)
    assert [each.numbers for each in series[1:3].frames] == [(1,), (2,)]
    np.testing.assert_array_equal(series[-1].values, series[3].values)
    with pytest.raises(IndexError):
        series[4]
    with pytest.raises(InvalidInput, match="wavelength is 800 nm; allowed: 750 nm, 850 nm"):
        series.at(800e-9)
    with pytest.raises(InvalidInput, match="wavelength is 2 of them"):
        series.mean()


def test_regions_give_a_row_for_each_volume_with_its_wavelength(folder):
    series = steradian.open(folder[0])
    box = Box("ball", ((-0.2e-3, 0.2e-3), (-0.2e-3, 0.2e-3), (0.9e-3, 1.1e-3)))
    rows = series.measure([box])
    assert [row["excitation"] for row in rows] == pytest.approx([750e-9] * 2 + [850e-9] * 2)
    first = series[0]
    inside = np.ix_(*((abs(line) <= 0.2e-3) for line in (first.axes.x, first.axes.y)), abs(first.axes.z - 1e-3) <= 1e-4)
    assert rows[0]["mean"] == pytest.approx(first.values[inside].mean(), rel=1e-5)
    assert rows[0]["frames"] == (0,)


def test_means_at_each_wavelength_unmix_to_the_saturation_of_the_ball(scan):
    series = steradian.open(scan).series(average=True, **FAST)
    assert [each.numbers for each in series.frames] == [(0, 1), (2, 3)]
    found = series.unmix(fluence=UniformFluence())
    ball = np.unravel_index(np.argmax(series[1].values), series[1].values.shape)
    assert found.saturation[ball] == pytest.approx(SATURATION, abs=0.02)


def test_unmix_command_writes_volumes_picture_and_report(scan, folder, tmp_path):
    told = run_here("unmix", folder[0], "--fluence", "uniform", "-o", "so2", cwd=tmp_path)
    assert "750, 850 nm" in told
    report = json.loads((tmp_path / "so2" / "report.json").read_text())
    assert report["saturation"]["median"] == pytest.approx(SATURATION, abs=0.05)
    assert report["notes"] == []
    saturation = steradian.open(tmp_path / "so2" / "saturation.h5")
    assert np.isfinite(saturation.values).sum() == report["voxels"]
    for name in ("oxyhaemoglobin", "deoxyhaemoglobin", "haemoglobin", "saturation-error"):
        assert steradian.open(tmp_path / "so2" / f"{name}.h5").values.shape == saturation.values.shape
    with Image.open(tmp_path / "so2" / "saturation.png") as drawn:
        assert drawn.width > 500
    warned = run_here("unmix", folder[0] / "series.h5", "-o", "plain", cwd=tmp_path)
    assert "oxygen saturation is biased" in " ".join(warned.split())


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--chromophore", "gold"), "chromophore is gold"),
        (("--chromophore", "water"), "wavelengths is 2 of 750, 850 nm; allowed: at least 3"),
        (("--fluence", "fit"), "wavelengths is 2; allowed: more than the 2 chromophores"),
        (("--fluence", "tissue", "--blood", 2), "blood is 2.0"),
    ],
)
def test_unmix_command_refuses_with_field_and_range(folder, tmp_path, words, told):
    out = run_here("unmix", folder[0], *words, "-o", "so2", cwd=tmp_path, code=2)
    assert told in " ".join(out.split())
    assert not (tmp_path / "so2").exists()


def test_series_of_one_wavelength_has_its_frames_only(scan):
    series = steradian.open(scan).series(wavelength=850e-9, **FAST)
    assert [each.numbers for each in series.frames] == [(2,), (3,)]
    with pytest.raises(InvalidInput, match="wavelength is 700 nm; allowed: one that the scan was measured at: 750 nm"):
        steradian.open(scan).series(wavelength=700e-9, **FAST)


@pytest.mark.long
def test_iterative_series_starts_from_the_frame_before_and_takes_fewer_products(scan):
    series = steradian.open(scan).series(method="iterative", **FAST)
    products = [volume.info.products for volume in series]
    cold = [steradian.open(scan).reconstruct(frame=n, method="iterative", **FAST) for n in range(4)]
    assert sum(products[1:]) <= 0.5 * sum(each.info.products for each in cold[1:])
    for volume, alone in zip(series, cold, strict=True):
        assert volume.info.residuals[-1] <= 1.02 * alone.info.residuals[-1]


def test_iterative_series_of_a_moving_object_fits_each_frame_as_well_as_alone(tmp_path):
    moving = write_scan(tmp_path / "scan.h5", step=150e-6)
    series = steradian.open(moving).series(method="iterative", **FAST)
    for number, volume in enumerate(series):
        alone = steradian.open(moving).reconstruct(frame=number, method="iterative", **FAST)
        assert volume.info.residuals[-1] <= 1.02 * alone.info.residuals[-1]
        at = np.unravel_index(volume.values.argmax(), volume.values.shape)
        assert abs(volume.axes.x[at[0]] - number * 150e-6) <= 0.1e-3


def test_saved_series_is_read_again_with_times(tmp_path):
    frames = [SeriesFrame((0,), 0.0, 0.5), SeriesFrame((1, 2), 0.0, None)]
    Series(frames, _volume).save(tmp_path / "a.h5")
    again = steradian.open(tmp_path / "a.h5")
    assert again.frames == tuple(frames)
    assert again.wavelengths == ()
    np.testing.assert_array_equal(again[1].values, _volume(1).values)
    with pytest.raises(InvalidInput, match="wavelengths is not stated"):
        again.unmix()
    with pytest.raises(InvalidInput, match=r"format is nrrd; allowed: hdf5, nifti"):
        again.save(tmp_path / "a.nrrd")


def _volume(number):
    axes = VoxelAxes(np.arange(3) * 1e-4, np.arange(4) * 1e-4, np.arange(5) * 1e-4)
    return Volume(np.full((3, 4, 5), number, np.float32), axes, (1e-4,) * 3, 1500.0)


def test_cancelled_series_leaves_no_file(scan, tmp_path):
    seen = []
    with pytest.raises(Cancelled):
        reconstruct_series(
            scan,
            tmp_path,
            ReconstructionParameters.create(**FAST),
            progress=lambda stage, *_: seen.append(stage),
            cancelled=lambda: any(stage.startswith("volume 2 of 4") for stage in seen),
        )
    assert list(tmp_path.iterdir()) == []


def test_large_series_is_refused_with_its_number_of_volumes(scan, tmp_path):
    with pytest.raises(InvalidInput, match=r"GB.*4 × 1500 × 1500"):
        reconstruct_series(scan, tmp_path, ReconstructionParameters.create(modes=1500), agreed=False)
    with pytest.raises(InvalidInput, match="GB"):
        reconstruct_series(scan, tmp_path / "none", ReconstructionParameters.create(modes=1500), agreed=False)
    assert not (tmp_path / "none").exists()


def test_volumes_on_other_voxels_and_files_of_another_kind_are_refused(tmp_path):
    def other(number):
        one = _volume(number)
        return one if number == 0 else Volume(one.values[:2], VoxelAxes(one.axes.x[:2], one.axes.y, one.axes.z),
                                              one.spacing, 1500.0)  # fmt: skip

    with pytest.raises(InvalidInput, match="those of the series' first volume"):
        Series([SeriesFrame((0,)), SeriesFrame((1,))], other).save(tmp_path / "a.h5")
    assert not (tmp_path / "a.h5").exists()
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file.attrs.update({"format": "steradian-series", "schema_version": 2})
    with pytest.raises(DamagedFile, match="schema_version is 2; allowed: 1"):
        read_series(tmp_path / "b.h5")
