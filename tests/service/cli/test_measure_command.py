"""``steradian measure`` of regions: rows equal NumPy's on the exported NIfTI; courses, maps and kept regions."""

import csv

import numpy as np
import pytest

import steradian
from steradian import Volume
from steradian.imaging import VoxelAxes
from steradian.reconstructions.series.frames import SeriesFrame
from steradian.reconstructions.series.series import Series
from support.commands import run_here

STEP = (100e-6, 80e-6, 50e-6)
AXES = VoxelAxes(*(step * (np.arange(16) - 8) for step in STEP[:2]), 1e-3 + STEP[2] * np.arange(24))
LIGHTS = (750e-9, 850e-9)
FRAMES = [SeriesFrame((n,), LIGHTS[n % 2], 0.5 * n) for n in range(12)]
BOX, BESIDE = "box vessel -0.31:0.31,-0.33:0.25,1.2:1.5", "box beside 0.4:0.8,-1:1,1:2.2"


def _volume(number):
    values = np.random.default_rng(number).normal(1.0, 0.1, (16, 16, 24)).astype(np.float32)
    values[4:12, 4:12] += 2.0 if number >= 6 else 1.0
    return Volume(values, AXES, STEP, 1500.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("series")
    Series(FRAMES, _volume).save(path / "series.h5")
    return path


def rows_of(path):
    return list(csv.DictReader(path.read_text().splitlines()))


def test_rows_are_those_of_numpy_on_the_exported_nifti(folder, tmp_path):
    import nibabel

    run_here("export", folder, "-o", "series.nii.gz", cwd=tmp_path)
    told = run_here("measure", folder, "--region", BOX, "--background", BESIDE, "-o", "table.csv", cwd=tmp_path)
    assert "vessel" in told
    image = nibabel.load(tmp_path / "series.nii.gz")
    values = np.asarray(image.dataobj, float)
    places = np.indices(values.shape[:3]).reshape(3, -1).T @ image.affine[:3, :3].T + image.affine[:3, 3]
    vessel, beside = (
        ((places >= low) & (places <= high)).all(axis=1).reshape(values.shape[:3])
        for low, high in (((-0.31, -0.33, 1.2 - 1e-6), (0.31, 0.25, 1.5 + 1e-6)), ((0.4, -1, 1), (0.8, 1, 2.2)))
    )
    rows = rows_of(tmp_path / "table.csv")
    assert [int(row["frames"]) for row in rows] == list(range(12))
    for number, row in enumerate(rows):
        inside, outside = values[vessel, number], values[beside, number]
        assert int(row["voxels"]) == inside.size
        expected = {
            "excitation": LIGHTS[number % 2],
            "time": 0.5 * number,
            "mean": inside.mean(),
            "deviation": inside.std(),
            "minimum": inside.min(),
            "maximum": inside.max(),
            "percentile_5": np.percentile(inside, 5),
            "percentile_95": np.percentile(inside, 95),
            "contrast_to_noise": (inside.mean() - outside.mean()) / outside.std(),
        }
        assert {name: float(row[name]) for name in expected} == pytest.approx(expected, rel=1e-6)


def test_courses_map_and_kept_regions_are_written(folder, tmp_path):
    words = ("--fit", "step", "--courses", "courses.csv", "--tsnr", "tsnr.h5", "--keep")
    told = run_here("measure", folder / "series.h5", "--region", BOX, *words, cwd=tmp_path)
    assert "temporal SNR" in told
    rows = rows_of(tmp_path / "courses.csv")
    assert [float(row["excitation"]) for row in rows] == pytest.approx(LIGHTS)
    for row in rows:
        assert float(row["amplitude"]) == pytest.approx(1.0, abs=0.05)
        assert float(row["time"]) == pytest.approx(2.5, abs=0.5)
    found = steradian.open(tmp_path / "tsnr-850nm.h5").values
    series = np.stack([_volume(n).values for n in range(1, 12, 2)]).astype(float)
    np.testing.assert_allclose(found, series.mean(axis=0) / series.std(axis=0, ddof=1), rtol=1e-4)
    run_here("measure", folder, "-o", "again.csv", cwd=tmp_path)  # regions.json beside the series
    assert {row["name"] for row in rows_of(tmp_path / "again.csv")} == {"vessel"}
    (folder / "regions.json").unlink()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((), "region is missing"),
        (("--region", "box a"), "region is box a; allowed: box NAME"),
        (("--region", BOX, "--region", BOX), "names that are different"),
        (("--region", BOX, "--fit", "ramp"), "fit is ramp; allowed: none, step, exponential"),
        (("--tsnr", "a.nii"), "tsnr is a.nii; allowed: a volume file, .h5"),
        (("--from", "0,0,1"), "vessel is missing"),
    ],
)
def test_measure_command_refuses_with_field_and_range(folder, tmp_path, words, told):
    out = run_here("measure", folder, *words, cwd=tmp_path, code=2)
    assert told in " ".join(out.split())
