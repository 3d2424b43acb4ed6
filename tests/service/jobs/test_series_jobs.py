"""Jobs of series: all frames as one result, its unmixing, and exports of the whole and of one volume."""

import json

import h5py
import numpy as np
import pytest

from steradian.core.exceptions import InvalidInput
from steradian.jobs.registry import JOB_TYPES
from steradian.jobs.tasks.context import JobContext
from steradian.reconstructions.pipeline.plan_cache import PlanCache
from steradian.reconstructions.series.series import read_series
from steradian.storage.blobs.interface import FolderBlobStore
from steradian.storage.data_dir.layout import DataDirectory
from support.series_scan import DEPTH, LIGHTS, SATURATION, write_scan

FAST = {"modes": 24, "depth_range": (0.6e-3, 1.6e-3)}


class Jobs:
    """A data directory with one scan; its jobs run in this process."""

    def __init__(self, folder):
        self.data, self.plans = DataDirectory(folder), PlanCache()
        self.data.create()
        write_scan(self.data.scan_file("s1"))

    def run(self, kind, name, **asked):
        root = self.data.job(name).root
        root.mkdir(parents=True, exist_ok=True)
        work = JobContext(self.data, root, "ada", self.plans, lambda *told: None, FolderBlobStore(self.data))
        return JOB_TYPES[kind].run(work, asked)


@pytest.fixture(scope="module")
def jobs(tmp_path_factory):
    return Jobs(tmp_path_factory.mktemp("jobs") / "data")


@pytest.fixture(scope="module")
def series(jobs):
    return jobs.run("reconstruction", "r1", scan_id="s1", parameters=FAST)


def test_reconstruction_of_a_scan_of_several_frames_has_a_volume_of_each(jobs, series):
    assert [each["numbers"] for each in series["frames"]] == [[0], [1], [2], [3]]
    assert [each["excitation_m"] for each in series["frames"]] == [LIGHTS[0]] * 2 + [LIGHTS[1]] * 2
    assert series["files"] == ["series.h5", "mip-z.png", "report.json"]
    for index in range(4):
        alone = jobs.run("reconstruction", f"alone{index}", scan_id="s1", frame=index, parameters=FAST)
        with h5py.File(jobs.data.job(f"alone{index}").volume) as file:
            values = np.asarray(file["values"])
        found = read_series(jobs.data.job("r1").root / "series.h5")[index].values
        assert np.abs(found - values).max() <= 1e-5 * np.abs(values).max()
        assert alone.get("frames") is None


@pytest.mark.parametrize(
    ("asked", "numbers"),
    [
        ({"wavelength": LIGHTS[1]}, [[2], [3]]),
        ({"average": True}, [[0, 1], [2, 3]]),
    ],
)
def test_request_limits_a_series_to_a_wavelength_or_to_means(jobs, asked, numbers):
    made = jobs.run("reconstruction", "some", scan_id="s1", parameters=FAST, **asked)
    assert [each["numbers"] for each in made["frames"]] == numbers


def test_mean_at_one_wavelength_is_a_single_volume(jobs):
    made = jobs.run("reconstruction", "mean", scan_id="s1", parameters=FAST, wavelength=LIGHTS[0], average=True)
    assert made.get("frames") is None
    assert jobs.data.job("mean").volume.is_file()


def test_unmixing_job_has_the_saturation_of_the_ball_at_its_place(jobs, series):
    asked = {"fluence": {"model": "uniform"}}
    made = jobs.run("unmixing", "u1", scan_id="s1", reconstruction_id="r1", unmixing=asked)
    names = [each["name"] for each in made["frames"]]
    assert names == ["saturation", "saturation-error", "haemoglobin", "oxyhaemoglobin", "deoxyhaemoglobin"]
    assert abs(made["unmixing"]["saturation"]["mean"] - SATURATION) < 0.03
    maps = read_series(jobs.data.job("u1").root / "series.h5")
    saturation, haemoglobin = (maps[names.index(name)] for name in ("saturation", "haemoglobin"))
    at = np.unravel_index(np.nanargmax(haemoglobin.values), haemoglobin.values.shape)
    assert abs(saturation.values[at] - SATURATION) < 0.03
    assert abs(haemoglobin.axes.z[at[2]] - DEPTH) < 0.1e-3
    assert np.isnan(saturation.values).mean() > 0.5, "voxels without signal are empty"
    assert (jobs.data.job("u1").root / "mip-z.png").is_file()


def test_unmixing_into_a_spectrum_of_ones_own_is_that_spectrums_share(jobs, series):
    flat = {"name": "dye", "wavelengths": [7e-7, 9e-7], "absorption": [1.0, 1.0]}
    asked = {"chromophores": ["dye"], "spectra": [flat], "fluence": {"model": "uniform"}, "wavelengths": [LIGHTS[0]]}
    made = jobs.run("unmixing", "u2", scan_id="s1", reconstruction_id="r1", unmixing=asked)
    assert [each["name"] for each in made["frames"]] == ["dye"]
    dye = read_series(jobs.data.job("u2").root / "series.h5")[0].values
    series = read_series(jobs.data.job("r1").root / "series.h5")
    mean = (series[0].values + series[1].values) / 2
    there = np.isfinite(dye)
    assert there.any()
    assert np.allclose(dye[there], mean[there], rtol=1e-4)


def test_unmixing_into_an_unknown_chromophore_names_the_known_ones(jobs, series):
    asked = {"chromophores": ["chlorophyll"]}
    with pytest.raises(InvalidInput, match=r"unmixing.chromophores is chlorophyll; allowed: oxyhaemoglobin"):
        jobs.run("unmixing", "u3", scan_id="s1", reconstruction_id="r1", unmixing=asked)


def test_exports_of_a_series_are_whole_or_of_one_volume(jobs, series):
    nibabel = pytest.importorskip("nibabel", reason="pip install nibabel")
    values = np.stack([volume.values for volume in read_series(jobs.data.job("r1").root / "series.h5")])
    whole = jobs.run("export", "e1", reconstruction_id="r1", format="nifti")
    image = nibabel.load(jobs.data.job("e1").root / whole["files"][0])
    assert np.array_equal(np.moveaxis(image.get_fdata(dtype=np.float32), 3, 0), values)
    one = jobs.run("export", "e2", reconstruction_id="r1", format="nifti", index=2)
    image = nibabel.load(jobs.data.job("e2").root / one["files"][0])
    assert np.array_equal(image.get_fdata(dtype=np.float32), values[2])


def test_quality_job_compares_volumes_of_series_by_index(jobs, series):
    made = jobs.run("quality", "q1", reconstruction_id="r1", index=0, reference_id="r1", reference_index=0)
    assert made["figures"]["volume_correlation"] == pytest.approx(1)
    with pytest.raises(InvalidInput, match="index is missing; allowed: 0 to 3"):
        jobs.run("quality", "q2", reconstruction_id="r1", reference_id="r1", reference_index=0)


def test_series_of_a_scan_that_ended_early_has_the_frames_with_alines(jobs):
    write_scan(jobs.data.scan_file("s2"), frames=3)
    made = jobs.run("reconstruction", "early", scan_id="s2", parameters=FAST)
    assert [each["numbers"] for each in made["frames"]] == [[0], [1], [2]]
    assert made["notes"][0] == "the last 1 of 4 frames have no A-lines: the scan ended before"


BOX = {"kind": "box", "name": "ball", "ranges": [[-2e-4, 2e-4], [-2e-4, 2e-4], [0.9e-3, 1.1e-3]]}
BESIDE = {"kind": "box", "name": "beside", "ranges": [[0.6e-3, 1.1e-3], [0.6e-3, 1.1e-3], [0.9e-3, 1.1e-3]]}


def test_regions_job_has_the_figures_of_numpy_for_each_volume(jobs, series):
    made = jobs.run("regions", "m1", reconstruction_id="r1", regions=[BOX], background=BESIDE)
    assert [(row["frames"], row["excitation"]) for row in made["rows"]] == [
        ([number], LIGHTS[number // 2]) for number in range(4)
    ]
    for row, volume in zip(made["rows"], read_series(jobs.data.job("r1").root / "series.h5"), strict=True):
        inside = np.ix_(*(_within(volume, name, BOX["ranges"]["xyz".index(name)]) for name in "xyz"))
        noise = np.ix_(*(_within(volume, name, BESIDE["ranges"]["xyz".index(name)]) for name in "xyz"))
        values, rest = volume.values[inside].astype(float), volume.values[noise].astype(float)
        assert row["voxels"] == values.size
        assert row["mean"] == pytest.approx(values.mean())
        assert row["percentile_95"] == pytest.approx(np.percentile(values, 95))
        assert row["contrast_to_noise"] == pytest.approx((values.mean() - rest.mean()) / rest.std())
    assert [course["volumes"] for course in made["courses"]] == [2, 2]
    table = (jobs.data.job("m1").root / "regions.csv").read_text().splitlines()
    assert len(table) == 5


def _within(volume, name, span):
    line = volume.coordinates(name)
    return np.flatnonzero((line >= span[0]) & (line <= span[1]))


def test_region_that_is_out_of_range_is_refused_with_its_number(jobs, series):
    with pytest.raises(InvalidInput, match=r"regions\.1\.kind is sphere; allowed: box, ellipsoid"):
        jobs.run("regions", "m2", reconstruction_id="r1", regions=[BOX, {"kind": "sphere", "name": "a"}])


def test_aligned_series_reports_the_shift_of_each_volume(jobs):
    made = jobs.run("reconstruction", "aligned", scan_id="s1", parameters=FAST, align=True)
    assert all(max(map(abs, each["shift"]["metres"])) < 20e-6 for each in made["frames"]), "the ball stays"
    assert "shifts.png" in made["files"]


@pytest.mark.parametrize(("format", "begins"), [("pdf", b"%PDF"), ("svg", b"<?xml"), ("gif", b"GIF8")])
def test_figure_job_draws_the_volumes_with_their_names(jobs, series, format, begins):
    made = jobs.run("figure", f"f-{format}", reconstruction_id="r1", format=format, indices=[0, 2])
    data = (jobs.data.job(f"f-{format}").root / made["files"][0]).read_bytes()
    assert data.startswith(begins)
    if format == "svg":
        assert b"750 nm, frame 0" in data
        assert b"850 nm, frame 2" in data


def test_figure_of_a_volume_beyond_the_series_is_refused(jobs, series):
    with pytest.raises(InvalidInput, match="indices is 4; allowed: 0 to 3"):
        jobs.run("figure", "f-beyond", reconstruction_id="r1", indices=[4])


def test_courses_of_the_maps_of_an_unmixing_are_apart(jobs, series):
    jobs.run("unmixing", "u4", scan_id="s1", reconstruction_id="r1", unmixing={"fluence": {"model": "uniform"}})
    made = jobs.run("regions", "m4", reconstruction_id="u4", regions=[BOX])
    rows = {row["map"]: row["mean"] for row in made["rows"]}
    assert abs(rows["saturation"] - SATURATION) < 0.03
    assert {course["map"]: course["mean"] for course in made["courses"]} == pytest.approx(rows)


def test_exported_maps_keep_their_names(jobs, series):
    jobs.run("unmixing", "u5", scan_id="s1", reconstruction_id="r1", unmixing={"fluence": {"model": "uniform"}})
    made = jobs.run("export", "e5", reconstruction_id="u5", format="hdf5")
    with h5py.File(jobs.data.job("e5").root / made["files"][0]) as file:
        assert json.loads(file.attrs["maps"])[:2] == ["saturation", "saturation-error"]


@pytest.mark.parametrize(
    ("regions", "message"),
    [
        ([BOX, BOX], "regions is ball; allowed: another name"),
        ([BOX | {"ranges": [[0, 10**400], [0, 1], [0, 1]]}], "regions.0"),
        ([{"kind": "polygon", "name": "p", "axis": "z", "corners": [[0, 0]] * 1001, "along": [0, 1]}], "at most 1000"),
    ],
)
def test_regions_that_cannot_be_told_apart_or_are_too_large_are_refused(jobs, series, regions, message):
    with pytest.raises(InvalidInput, match=message):
        jobs.run("regions", "m5", reconstruction_id="r1", regions=regions)


def test_figure_draws_a_label_as_it_is_written(jobs, series):
    asked = {"format": "svg", "indices": [0], "label": r"price $5 to $6 of \foo"}
    made = jobs.run("figure", "f-label", reconstruction_id="r1", **asked)
    text = (jobs.data.job("f-label").root / made["files"][0]).read_text()
    assert r"\foo" in text
    with pytest.raises(InvalidInput, match="allowed: printable"):
        jobs.run("figure", "f-control", reconstruction_id="r1", label="p\x01q")


@pytest.mark.parametrize("name", ["x; touch y", "saturation", ""])
def test_name_of_a_spectrum_is_a_word_and_not_that_of_a_map(jobs, series, name):
    spectrum = {"name": name, "wavelengths": [7e-7, 9e-7], "absorption": [1.0, 1.0]}
    with pytest.raises(InvalidInput, match="name"):
        jobs.run("unmixing", "u6", scan_id="s1", reconstruction_id="r1", unmixing={"spectra": [spectrum]})
