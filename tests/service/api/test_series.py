"""Series over HTTP: each volume by its index, the picture of all, unmixing requests, and what is refused."""

import json
import warnings

import h5py
import numpy as np
import pytest

from steradian.imaging import Volume, VoxelAxes
from steradian.jobs.job import Succeeded
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.reconstructions.series.file import SeriesWriter
from steradian.reconstructions.series.frames import SeriesFrame
from steradian.reconstructions.volumes.file import write_volume

from .conftest import make_scan_with_alines

RAW = {"Accept": "application/octet-stream"}
SHAPE = (5, 6, 9)
VALUES = np.random.default_rng(7).normal(size=(3, *SHAPE)).astype(np.float32)
AXES = VoxelAxes(*(np.arange(size) * 1e-4 for size in SHAPE))
FRAMES = [SeriesFrame((0,), 750e-9, 0.0), SeriesFrame((1,), 750e-9, 4.0), SeriesFrame((2, 3), 850e-9)]


@pytest.fixture(scope="module")
def scan(server, http):
    """A scan of two wavelengths, twice each."""
    mask = http.post("/masks", json={"arrangement": "equi-steradian", "aperture": 0.01, "depth": 0.004, "count": 40})
    asked = {"mask_id": mask.json()["id"], "samples": 64, "frames": 2, "excitation": [750e-9, 850e-9]}
    plan = http.post("/plans", json=asked).json()["id"]
    return make_scan_with_alines(server, http, plan)["scan"]["id"]


def settle(server, http, scan, write, report):
    """Have a reconstruction succeed with a file and a report; returns its identifier."""
    job = http.post("/reconstructions", json={"scan_id": scan, "parameters": {"modes": 4}}).json()["id"]
    folder, ledger = server.data.job(job), JobLedger(server.database)
    folder.root.mkdir(parents=True)
    write(folder.root)
    ledger.start_attempt(job, "worker-8")
    ledger.finish_attempt(job, 1, Succeeded(report), "worker-8")
    return job


@pytest.fixture(scope="module")
def series(server, http, scan):
    """A series of three volumes."""

    def write(folder):
        with SeriesWriter(folder / "series.h5", parameters={}, provenance={}) as writer:
            for frame, values in zip(FRAMES, VALUES, strict=True):
                writer.add(frame, Volume(values, AXES, (1e-4, 1e-4, 1e-4)))
        (folder / "mip-z.png").write_bytes(b"\x89PNG all of them")

    frames = [{"numbers": each.numbers, "excitation_m": each.excitation, "time_s": each.time} for each in FRAMES]
    return settle(server, http, scan, write, {"shape": SHAPE, "frames": frames})


@pytest.fixture(scope="module")
def volume(server, http, scan):
    def write(folder):
        write_volume(folder / "volume.h5", Volume(VALUES[0], AXES, (1e-4,) * 3), parameters={}, provenance={})

    return settle(server, http, scan, write, {"shape": SHAPE})


def numbers(answer):
    assert answer.status_code == 200, answer.text
    shape = tuple(int(size) for size in answer.headers["x-shape"].split(",") if size)
    return np.frombuffer(answer.content, answer.headers["x-dtype"]).reshape(shape)


def test_report_lists_the_volumes_of_a_series_in_the_order_of_index(http, series):
    frames = http.get(f"/reconstructions/{series}").json()["report"]["frames"]
    assert [(each["numbers"], each["excitation_m"], each["time_s"]) for each in frames] == [
        ([0], 750e-9, 0.0),
        ([1], 750e-9, 4.0),
        ([2, 3], 850e-9, None),
    ]


@pytest.mark.parametrize("index", [0, 1, 2])
def test_volume_slice_and_projections_of_an_index_are_those_of_its_frame(http, series, index):
    at, which = f"/reconstructions/{series}", {"index": index}
    assert np.array_equal(numbers(http.get(f"{at}/volume", headers=RAW, params=which)), VALUES[index])
    part = http.get(f"{at}/volume", headers=RAW, params=which | {"slice": "1:3,2,::2"})
    assert np.array_equal(numbers(part), VALUES[index][1:3, 2, ::2])
    for axis, along in enumerate("xyz"):
        whole = http.get(f"{at}/mip", headers=RAW, params=which | {"axis": along})
        assert np.array_equal(numbers(whole), VALUES[index].max(axis=axis))
    slab = http.get(f"{at}/mip", headers=RAW, params=which | {"axis": "z", "slab": "2:5"})
    assert np.array_equal(numbers(slab), VALUES[index][..., 2:5].max(axis=2))


def test_volume_of_a_series_is_a_hierarchy_of_ome_zarr(server, http, series):
    address = f"{server.url}/api/v1/reconstructions/{series}/volume.ome.zarr/2"
    group = http.get(f"{address}/zarr.json")
    assert group.status_code == 200, group.text
    assert "ome" in group.json()["attributes"]
    assert http.get(f"{address}/../3/zarr.json").status_code in (404, 422)
    about = json.loads(http.get(f"{address}/0/zarr.json").content)
    assert about["shape"] == list(SHAPE[::-1])
    chunk = np.frombuffer(http.get(f"{address}/0/c/0/0/0").content, np.float32)
    assert np.array_equal(chunk.reshape(about["chunk_grid"]["configuration"]["chunk_shape"][::-1]), VALUES[2])


@pytest.mark.parametrize("part", ["volume", "mip"])
@pytest.mark.parametrize(("index", "value"), [({}, "missing"), ({"index": 3}, "3")])
def test_index_beyond_a_series_or_missing_is_refused_with_the_range(http, series, part, index, value):
    refused = http.get(f"/reconstructions/{series}/{part}", headers=RAW, params=index)
    assert refused.status_code == 422, refused.text
    assert refused.json()["errors"], refused.text
    error = refused.json()["errors"][0]
    assert (error["place"], error["pointer"]) == ("query", "index")
    assert error["allowed"] == "0 to 2: which volume of the series"
    assert value in error["detail"]


def test_index_of_a_single_volume_is_0(http, volume):
    at = f"/reconstructions/{volume}/volume"
    assert np.array_equal(numbers(http.get(at, headers=RAW, params={"index": 0})), VALUES[0])
    assert http.get(at, headers=RAW, params={"index": 1}).json()["errors"][0]["allowed"].startswith("0")


def test_picture_of_a_series_is_of_all_volumes_along_z(http, series):
    at, png = f"/reconstructions/{series}/mip", {"Accept": "image/png"}
    assert http.get(at, headers=png).content == b"\x89PNG all of them"
    assert http.get(at, headers=png, params={"axis": "x"}).status_code == 404
    assert http.get(at, headers=png, params={"index": 0}).json()["errors"][0]["pointer"] == "index"


UNMIXING = {"unmixing": {"fluence": {"model": "tissue", "blood": 0.03}}}


def test_unmixing_of_a_series_is_queued_as_a_reconstruction_of_its_scan(http, scan, series):
    asked = {"scan_id": scan, "reconstruction_id": series, **UNMIXING}
    made = http.post("/reconstructions", json=asked)
    assert made.status_code == 202, made.text
    seen = made.json()
    assert (seen["kind"], seen["scan_id"], seen["reconstruction_id"]) == ("unmixing", scan, series)
    assert seen["unmixing"]["fluence"]["blood"] == 0.03
    assert seen["id"] in [each["id"] for each in http.get("/reconstructions?kind=unmixing").json()["items"]]


REFUSED = {
    "unmixing without a series": (UNMIXING, "reconstruction_id"),
    "series without unmixing": ({"reconstruction_id": "SERIES"}, "reconstruction_id"),
    "a single volume": ({"reconstruction_id": "VOLUME", **UNMIXING}, "reconstruction_id"),
    "three chromophores of two wavelengths": (
        {"reconstruction_id": "SERIES", "unmixing": {"chromophores": ["oxyhaemoglobin", "deoxyhaemoglobin", "water"]}},
        "reconstruction_id",
    ),
    "parameters": ({"reconstruction_id": "SERIES", "parameters": {"modes": 8}, **UNMIXING}, "parameters"),
    "a frame": ({"reconstruction_id": "SERIES", "frame": 0, **UNMIXING}, "frame"),
    "blood above 1": ({"reconstruction_id": "SERIES", "unmixing": {"fluence": {"blood": 2}}}, "unmixing.fluence.blood"),
    "a wavelength that was not measured": ({"wavelength": 800e-9}, "wavelength"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_request_that_fits_no_series_is_refused_with_its_field(http, server, scan, series, volume, name):
    asked, field = REFUSED[name]
    named = {"SERIES": series, "VOLUME": volume}
    body = {key: named.get(value, value) if isinstance(value, str) else value for key, value in asked.items()}
    refused = http.post("/reconstructions", json={"scan_id": scan, **body})
    assert refused.status_code == 422, refused.text
    assert refused.json()["errors"][0]["pointer"] == f"#/{field.replace('.', '/')}", refused.text


def test_deleting_a_series_deletes_its_unmixing_and_what_was_made_of_that(http, server, scan):
    def write(folder):
        with SeriesWriter(folder / "series.h5", parameters={}, provenance={}) as writer:
            for frame, values in zip(FRAMES, VALUES, strict=True):
                writer.add(frame, Volume(values, AXES, (1e-4, 1e-4, 1e-4)))

    frames = [{"excitation_m": each.excitation} for each in FRAMES]
    series = settle(server, http, scan, write, {"shape": SHAPE, "frames": frames})
    asked = {"scan_id": scan, "reconstruction_id": series, **UNMIXING}
    maps = http.post("/reconstructions", json=asked).json()["id"]
    folder, ledger = server.data.job(maps), JobLedger(server.database)
    folder.root.mkdir(parents=True)
    write(folder.root)
    ledger.start_attempt(maps, "worker-8")
    ledger.finish_attempt(maps, 1, Succeeded({"frames": frames}), "worker-8")
    export = {"kind": "export", "reconstruction_id": maps, "format": "nifti", "index": 0}
    job = http.post("/jobs", json=export).json()["id"]
    http.put(f"/jobs/{job}/desired-state", json={"state": "cancelled"})
    deleted = http.delete(f"/reconstructions/{series}", params={"dependents": True})
    assert deleted.status_code in (202, 204), deleted.text
    assert http.get(f"/reconstructions/{maps}").status_code == 404
    assert http.get(f"/jobs/{job}").status_code == 404


def test_file_of_maps_without_values_has_coarser_copies_of_the_values_there_are(tmp_path):
    values = np.full((280, 4, 8), np.nan, np.float32)
    values[0, 0, 0] = 0.8
    axes = VoxelAxes(*(np.arange(size) * 1e-4 for size in values.shape))
    with SeriesWriter(tmp_path / "maps.h5", parameters={}, provenance={}) as writer:
        projections = {axis: np.nanmax(values, axis=n, initial=0) for n, axis in enumerate("xyz")}
        writer.add(SeriesFrame((), name="saturation"), Volume(values, axes, (1e-4,) * 3), projections=projections)
    with h5py.File(tmp_path / "maps.h5") as file:
        coarse = np.asarray(file["frames/0/levels/1"])
    assert coarse[0, 0, 0] == np.float32(0.8)
    assert np.isnan(coarse).sum() == coarse.size - 1


def test_projections_of_maps_leave_out_voxels_without_a_value(server, http, scan):
    maps = np.full((2, *SHAPE), np.nan, np.float32)
    maps[0, 2, 3, 4:6] = 0.9, 0.7
    maps[1, 2, 3, 1] = 0.5
    names = [SeriesFrame((), name=name) for name in ("saturation", "haemoglobin")]

    def write(folder):
        with SeriesWriter(folder / "series.h5", parameters={}, provenance={}) as writer:
            for frame, values in zip(names, maps, strict=True):
                with warnings.catch_warnings(action="ignore"):
                    found = {axis: np.nanmax(values, axis=n) for n, axis in enumerate("xyz")}
                writer.add(frame, Volume(values, AXES, (1e-4, 1e-4, 1e-4)), projections=found)

    made = settle(server, http, scan, write, {"shape": SHAPE, "frames": [{"name": each.name} for each in names]})
    at = f"/reconstructions/{made}/mip"
    slab = numbers(http.get(at, headers=RAW, params={"index": 0, "axis": "z", "slab": "1:"}))
    assert slab[2, 3] == np.float32(0.9)
    assert np.isfinite(slab).sum() == 1
    depths = numbers(http.get(at, headers=RAW, params={"index": 0, "axis": "depth"}))
    assert depths[2, 3] == pytest.approx(4e-4)
    pooled = numbers(http.get(at, headers=RAW, params={"index": 0, "axis": "z", "max_size": 3}))
    assert pooled[1, 1] == np.float32(0.9)
    told = http.get(at, headers={"Accept": "application/json"}, params={"index": 0, "axis": "z"})
    assert told.json()["values"][2][3] == pytest.approx(0.9)
    assert told.json()["values"][0][0] is None


def test_links_of_a_series_lead_to_answers(http, series):
    links = http.get(f"/reconstructions/{series}").json()["links"]
    assert "ome_zarr" not in links
    assert [name for name in links if name.startswith("mip")] == ["mip_z"]
    assert http.get(links["mip_z"].removeprefix("/api/v1"), headers={"Accept": "image/png"}).status_code == 200


@pytest.mark.parametrize("index", ["3", "9" * 5000, "x", ""])
def test_hierarchy_of_a_volume_that_is_not_there_is_not_found(http, series, index):
    answer = http.get(f"/reconstructions/{series}/volume.ome.zarr/{index}/zarr.json")
    assert answer.status_code in (404, 422), answer.text


def test_memory_that_a_job_on_a_series_needs_is_that_of_one_volume(http, server, series):
    whole = (server.data.job(series).root / "series.h5").stat().st_size
    box = {"kind": "box", "name": "a", "ranges": [[0, 1], [0, 1], [0, 1]]}
    asked = {"kind": "regions", "reconstruction_id": series, "regions": [box]}
    made = http.post("/jobs", json=asked).json()
    http.put(f"/jobs/{made['id']}/desired-state", json={"state": "cancelled"})
    assert made["requires"]["memory"] == whole // 3


def test_comparison_of_volumes_of_a_series_is_listed_with_its_indices(http, series):
    asked = {"reference_id": series, "index": 1, "reference_index": 2}
    made = http.post(f"/reconstructions/{series}/quality", json=asked)
    assert made.status_code == 202, made.text
    (listed,) = http.get(f"/reconstructions/{series}/quality").json()["items"]
    assert (listed["index"], listed["reference_index"]) == (1, 2)
    http.put(f"/jobs/{made.json()['id']}/desired-state", json={"state": "cancelled"})


def test_fit_of_the_light_needs_one_more_wavelength_than_chromophores(http, scan, series):
    asked = {"scan_id": scan, "reconstruction_id": series, "unmixing": {"fluence": {"model": "fit"}}}
    refused = http.post("/reconstructions", json=asked)
    assert refused.status_code == 422
    assert "at least 3 stated wavelengths" in refused.json()["errors"][0]["allowed"]


@pytest.mark.parametrize("kind", ["quality", "export", "width"])
@pytest.mark.parametrize(("index", "value"), [(None, "missing"), (3, "3")])
def test_job_without_a_volume_of_the_series_is_refused_before_it_is_queued(http, scan, series, kind, index, value):
    asked = {
        "quality": {"reference_id": series, "reference_index": 0},
        "export": {"format": "nifti"},
        "width": {"scan_id": scan, "start": [0, 0, 1e-4], "end": [4e-4, 0, 1e-4]},
    }[kind]
    answer = http.post("/jobs", json={"kind": kind, "reconstruction_id": series, "index": index, **asked})
    if kind == "export" and index is None:  # all volumes in one file
        assert answer.status_code == 202, answer.text
        http.put(f"/jobs/{answer.json()['id']}/desired-state", json={"state": "cancelled"})
        return
    assert answer.status_code == 422, answer.text
    error = answer.json()["errors"][0]
    assert error["pointer"] == "#/index"
    assert error["allowed"].startswith("0 to 2")
    assert f"index is {value}" in error["detail"]
