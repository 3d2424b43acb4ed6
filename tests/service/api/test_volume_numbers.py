"""Volumes and projections as numbers: values, types and places against the array they were made of."""

import io
import json
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from steradian.imaging import Volume, VoxelAxes
from steradian.jobs.job import Succeeded
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.reconstructions.volumes import lazy_array as stored_values
from steradian.reconstructions.volumes.file import write_projections, write_volume
from steradian.reconstructions.volumes.projections import project
from steradian.reconstructions.volumes.reader import VolumeReader
from steradian.reconstructions.volumes.zarr_view import get_node

RAW = {"Accept": "application/octet-stream"}
SHAPE, SPACING = (9, 10, 23), (1e-4, 2e-4, 3e-5)
VALUES = np.random.default_rng(5).normal(size=SHAPE).astype(np.float32)
LINES = [np.arange(size) * step - 4 * step for size, step in zip(SHAPE, SPACING, strict=True)]
VOLUME = Volume(VALUES, VoxelAxes(*LINES), SPACING)


@pytest.fixture(scope="module")
def made(server, http):
    """Where a reconstruction of known values is."""
    mask = http.post("/masks", json={"arrangement": "equi-steradian", "aperture": 0.01, "depth": 0.004, "count": 40})
    plan = http.post("/plans", json={"mask_id": mask.json()["id"], "samples": 64}).json()["id"]
    scan = http.post("/scans", json={"plan_id": plan}, headers={"Idempotency-Key": "numbers"}).json()["id"]

    def make(**more):
        job = http.post("/reconstructions", json={"scan_id": scan, "parameters": {"modes": 4}, **more})
        identifier = job.json()["id"]
        server.data.job(identifier).root.mkdir(parents=True)
        return identifier

    return make


def settle(server, identifier, volume):
    """Have a reconstruction succeed with a volume."""
    folder, ledger = server.data.job(identifier), JobLedger(server.database)
    write_volume(folder.volume, volume, parameters={}, provenance={})
    ledger.start_attempt(identifier, "worker-8")
    ledger.finish_attempt(identifier, 1, Succeeded({"shape": list(volume.values.shape)}), "worker-8")
    return f"/reconstructions/{identifier}"


@pytest.fixture(scope="module")
def finished(server, made):
    return settle(server, made(follow=True), VOLUME)


@pytest.fixture(scope="module")
def long(server, made):
    """One that is long enough for two levels."""
    values = np.random.default_rng(6).normal(size=(280, 4, 8)).astype(np.float32)
    axes = VoxelAxes(*(np.arange(size) * 1e-4 for size in values.shape))
    return SimpleNamespace(
        values=values, at=settle(server, made(follow=True), Volume(values, axes, (1e-4, 1e-4, 1e-4)))
    )


def numbers(answer):
    shape = tuple(int(size) for size in answer.headers["x-shape"].split(",") if size)
    return np.frombuffer(answer.content, answer.headers["x-dtype"]).reshape(shape)


def places(answer):
    """Where the values lie, by name of the axis (m)."""
    told = [answer.headers[name].split(",") for name in ("x-axes", "x-origin", "x-spacing", "x-shape")]
    lines = zip(*told, strict=True)
    return {name: float(first) + float(step) * np.arange(int(size)) for name, first, step, size in lines if name}


@pytest.mark.parametrize("axis", "xyz")
@pytest.mark.parametrize("slab", [None, "2:7", "3", "1:9:3"])
def test_a_projection_is_of_the_slab_and_lies_where_the_volume_does(http, finished, axis, slab):
    along = "xyz".index(axis)
    chosen = np.r_[eval(f"np.s_[{slab or ':'}]")] if slab != "3" else [3]  # noqa: S307
    part = VALUES if slab is None else np.take(VALUES, [at for at in chosen if at < SHAPE[along]], along)
    asked = {"axis": axis} | ({"slab": slab} if slab else {})
    answer = http.get(f"{finished}/mip", params=asked, headers=RAW)
    np.testing.assert_array_equal(numbers(answer), part.max(axis=along))
    found = places(answer)
    assert [*found] == [name for name in "xyz" if name != axis]
    for name, line in found.items():
        np.testing.assert_allclose(line, LINES["xyz".index(name)], atol=1e-12)


def test_downsampled_projection_preserves_block_maxima(http, finished):
    answer = http.get(f"{finished}/mip", params={"axis": "y", "max_size": 6}, headers=RAW)
    image, whole = numbers(answer), VALUES.max(axis=1)
    assert image.shape == (3, 6)
    assert answer.headers["x-level"] == "2"
    expected = [[whole[4 * i : 4 * i + 4, 4 * k : 4 * k + 4].max() for k in range(6)] for i in range(3)]
    np.testing.assert_array_equal(image, expected)
    middles = [LINES[2][4 * k : 4 * k + 4].mean() for k in range(5)]
    np.testing.assert_allclose(places(answer)["z"][:5], middles, atol=1e-12)


def test_a_map_of_depths_is_in_metres(http, finished):
    answer = http.get(f"{finished}/mip", params={"axis": "depth", "slab": "4:"}, headers=RAW)
    np.testing.assert_allclose(numbers(answer), LINES[2][4 + VALUES[..., 4:].argmax(axis=2)], rtol=1e-6)


@pytest.mark.parametrize(("window", "least", "greatest"), [(None, 0, VALUES.max()), ("-1,0.5", -1, 0.5)])
def test_bytes_go_by_the_window(http, finished, window, least, greatest):
    asked = {"slice": "3", "dtype": "uint8"} | ({"window": window} if window else {})
    answer = http.get(f"{finished}/volume", params=asked, headers=RAW)
    expected = np.clip((VALUES[3].astype(float) - least) / (float(greatest) - least), 0, 1) * 255
    assert answer.headers["x-dtype"] == "|u1"
    assert np.abs(numbers(answer) - expected).max() <= 0.5001
    assert [float(end) for end in answer.headers["x-window"].split(",")] == pytest.approx([least, greatest])


@pytest.mark.parametrize("accept", ["application/x-npy", "application/octet-stream", "application/json"])
@pytest.mark.parametrize("part", ["2:5,::3,7", "4", ":,3"])
def test_volume_slice_returns_values_and_axes_in_every_format(http, finished, accept, part):
    answer = http.get(f"{finished}/volume", params={"slice": part}, headers={"Accept": accept})
    if accept == "application/json":
        body = answer.json()
        found = np.array(body["values"], np.float32)
        lines = {one["name"]: one["origin_m"] + one["spacing_m"] * np.arange(one["size"]) for one in body["axes"]}
    else:
        found = np.load(io.BytesIO(answer.content)) if "npy" in accept else numbers(answer)
        lines = places(answer)
    np.testing.assert_array_equal(found, eval(f"VALUES[{part}]"))  # noqa: S307 - the claim is that it is the same
    texts = [*part.split(","), ":", ":"][:3]
    for name, whole, text in zip("xyz", LINES, texts, strict=True):
        chosen = eval("whole[" + text + "]", {"whole": whole})  # noqa: S307
        assert (name in lines) is (np.ndim(chosen) == 1)
        if name in lines:
            np.testing.assert_allclose(lines[name], chosen, atol=1e-12)


@pytest.mark.parametrize("level", [0, 1, 2])
def test_of_an_empty_slice_nothing_comes_at_any_level(http, long, level):
    answer = http.get(f"{long.at}/volume", params={"slice": "3:3,0", "level": level}, headers=RAW)
    assert (answer.headers["x-shape"], answer.content) == (f"0,{8 >> level}", b"")


@pytest.mark.parametrize("worst", [np.nan, np.inf])
def test_uint8_window_ignores_non_finite_voxels(http, server, made, worst):
    values = np.ones((4, 5, 6), np.float32)
    values[1, 1, 1] = worst
    axes = VoxelAxes(*(np.arange(size) * 1e-4 for size in values.shape))
    at = settle(server, made(follow=True), Volume(values, axes, (1e-4, 1e-4, 1e-4)))
    answer = http.get(f"{at}/volume", params={"slice": "0,0", "dtype": "uint8"})
    assert answer.headers["x-window"] == "0,1"


@pytest.mark.parametrize(
    ("asked", "level", "part"),
    [
        ({}, 0, "[:, :, :]"),
        ({"level": 1}, 1, "[:, :, :]"),
        ({"level": 2}, 2, "[:, :, :]"),
        ({"max_size": 100}, 2, "[:, :, :]"),
        ({"slice": ":,3", "max_size": 140}, 1, "[:, 1]"),
        ({"slice": "10:13,3", "max_size": 4}, 1, "[5:7, 1]"),
        ({"slice": "10:14,3", "level": 2}, 2, "[2:4, 0]"),
        ({"slice": "9:17,3", "max_size": 4}, 2, "[2:5, 0]"),
        ({"max_size": 2}, 2, "[:, :, :]"),
        ({"slice": "1:131,3", "max_size": 65}, 2, "[0:33, 0]"),
    ],
)
def test_a_coarser_level_shows_the_same_place(http, long, asked, level, part):
    """Indices are the full volume's; the level is the one asked for, or the finest that is small enough, if any is."""
    expected = long.values
    for _ in range(level):
        expected = expected.reshape([n for size in expected.shape for n in (size // 2, 2)]).mean(axis=(1, 3, 5))
    answer = http.get(f"{long.at}/volume", params=asked, headers=RAW)
    assert answer.headers["x-level"] == str(level)
    np.testing.assert_allclose(numbers(answer), eval(f"expected{part}"), atol=1e-6)  # noqa: S307
    first = eval(f"np.arange(280 // 2**{level}){part.split(',')[0]}]")[0]  # noqa: S307
    middle = np.mean(1e-4 * (2**level * first + np.arange(2**level)))
    assert places(answer)["x"][0] == pytest.approx(middle, abs=1e-12)


def test_steps_and_levels_that_are_not_there_are_refused(http, long):
    for asked, name in (({"level": 3}, "level"), ({"level": 1, "slice": "::2"}, "slice")):
        answer = http.get(f"{long.at}/volume", params=asked, headers=RAW)
        assert (answer.status_code, answer.json()["errors"][0]["pointer"]) == (422, name)


@pytest.mark.parametrize(
    ("path", "asked", "field"),
    [
        ("mip", {"slab": "5:5"}, "slab"),
        ("mip", {"slab": "99"}, "slab"),
        ("mip", {"slab": "1:3,2"}, "slab"),
        ("mip", {"window": "0,1"}, "window"),
        ("mip", {"dtype": "uint8", "window": "1,0"}, "window"),
        ("mip", {"dtype": "uint8", "window": "0,inf"}, "window"),
        ("mip", {"dtype": "uint8", "window": "0,1e39"}, "window"),
        ("volume", {"dtype": "uint8", "window": "-3e38,3e38"}, "window"),
        ("volume", {"dtype": "uint8", "window": "0,1e-40"}, "window"),
        ("volume", {"dtype": "uint8", "window": "zero"}, "window"),
        ("volume", {"level": "9"}, "level"),
        ("volume", {"slice": "1,2,3,4"}, "slice"),
    ],
)
def test_invalid_volume_query_parameter_returns_422_with_pointer(http, finished, path, asked, field):
    answer = http.get(f"{finished}/{path}", params=asked, headers=RAW)
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid-input")
    assert answer.json()["errors"][0]["pointer"] == field


def test_a_picture_takes_nothing_that_is_for_numbers(http, finished):
    answer = http.get(f"{finished}/mip", params={"slab": "1:3"}, headers={"Accept": "image/png"})
    assert (answer.status_code, answer.json()["errors"][0]["pointer"]) == (422, "slab")


def test_the_projections_of_a_running_scan_are_numbers_too(server, http, made):
    identifier = made(follow=True)
    here, folder, ledger = f"/reconstructions/{identifier}/mip", server.data.job(identifier), JobLedger(server.database)
    ledger.start_attempt(identifier, "worker-8")
    assert http.get(here, headers=RAW).status_code == 409
    for number, times in ((1, 1), (2, 3)):
        louder = Volume(VALUES * times, VOLUME.axes, SPACING)
        write_projections(folder.root / "projections.h5", louder, project(louder))
        folder.revision.write_text(f'{{"number": {number}}}')
        answer = http.get(here, params={"axis": "x"}, headers=RAW)
        np.testing.assert_array_equal(numbers(answer), times * VALUES.max(axis=0))
        np.testing.assert_allclose(places(answer)["y"], LINES[1], atol=1e-12)
        same = http.get(here, params={"axis": "x"}, headers=RAW | {"If-None-Match": answer.headers["etag"]})
        assert same.status_code == 304
    refused = http.get(here, params={"slab": "1:3"}, headers=RAW)
    assert (refused.status_code, refused.json()["errors"][0]["pointer"]) == (422, "slab")


@pytest.mark.long
def test_zarr_python_opens_a_volume_by_its_address(server, long):
    """As a viewer does: metadata of the group, then of each level; voxel sizes and places in micrometres."""
    zarr = pytest.importorskip("zarr")
    obstore = pytest.importorskip("obstore")
    address = f"{server.url}/api/v1{long.at}/volume.ome.zarr"
    store = obstore.store.HTTPStore.from_url(address, client_options={"allow_http": True, "timeout": "90s"})
    group = zarr.open_group(zarr.storage.ObjectStore(store, read_only=True), mode="r")
    scales = group.attrs["ome"]["multiscales"][0]
    assert [(axis["name"], axis["unit"]) for axis in scales["axes"]] == [(name, "micrometer") for name in "zyx"]
    expected = long.values
    for level, dataset in enumerate(scales["datasets"]):
        array = group[dataset["path"]]
        assert array.metadata.dimension_names == ("z", "y", "x")
        np.testing.assert_allclose(array[...], expected.T, atol=1e-6)
        np.testing.assert_array_equal(array[1, :, 2:5], array[...][1, :, 2:5])
        scale, translation = (one[one["type"]] for one in dataset["coordinateTransformations"])
        assert scale == pytest.approx([100 * 2**level] * 3)
        assert translation == pytest.approx([100 * (2**level - 1) / 2] * 3)
        if level < 2:
            expected = expected.reshape([n for size in expected.shape for n in (size // 2, 2)]).mean(axis=(1, 3, 5))
    assert level == 2


def test_a_volume_in_one_piece_is_the_same_hierarchy(tmp_path, monkeypatch):
    """Planes are its chunks, the last ones filled up."""
    monkeypatch.setattr(stored_values, "CHUNK_BYTES", 4 * 10 * 23 * 4)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        about = {"axes": "x, y, z", "spacing_m": SPACING, "origin_m": VOLUME.origin}
        file.create_dataset("values", data=VALUES).attrs.update(about)
    stored = VolumeReader(tmp_path / "a.h5")
    about = json.loads(get_node(stored, "0/zarr.json"))
    assert about["chunk_grid"]["configuration"]["chunk_shape"] == [23, 10, 4]
    pieces = [np.frombuffer(get_node(stored, f"0/c/0/0/{x}"), "<f4").reshape(4, 10, 23) for x in range(3)]
    np.testing.assert_array_equal(np.concatenate(pieces)[:9], VALUES)
    assert not pieces[2][1:].any()


@pytest.mark.parametrize(
    "path",
    ["", "0", ".zgroup", "zarr.json/", "3/zarr.json", "0/c/0/0", "0/c/0/0/5", "0/c/0/0/0/0", "0/c/00/0/0",
     "-1/zarr.json", "..%2f..%2fzarr.json", "0/c/9999999999/0/0", "0/.zarray"],
)  # fmt: skip
def test_unknown_ome_zarr_member_returns_404(http, long, path):
    answer = http.get(f"{long.at}/volume.ome.zarr/{path}")
    assert (answer.status_code, answer.headers["content-type"]) == (404, "application/problem+json")
