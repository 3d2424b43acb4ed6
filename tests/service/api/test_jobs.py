"""Jobs beyond reconstructions: what is refused before it is queued, what is queued, and what can be had afterwards."""

import json
import os
import socket
import uuid
import zlib

import numpy as np
import pytest
from sqlalchemy import update

from steradian.imaging import Volume, VoxelAxes
from steradian.jobs import request_versions as forms
from steradian.jobs.job import Succeeded
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.jobs.registry import JOB_TYPES
from steradian.reconstructions.volumes.file import write_volume
from steradian.storage.db.tables import JobRow, ScanRow
from support.processes import resident


def volume(side=4, depth=8):
    values = np.random.default_rng(1).normal(size=(side, side, depth)).astype(np.float32)
    axes = VoxelAxes(np.arange(side) * 1e-3, np.arange(side) * 1e-3, np.arange(depth) * 1e-4)
    return Volume(values, axes, (1e-3, 1e-3, 1e-4))


@pytest.fixture
def ledger(server):
    return JobLedger(server.database)


def succeed(server, ledger, job_id, **result):
    ledger.start_attempt(job_id, "worker-9")
    ledger.finish_attempt(job_id, 1, Succeeded(result), "worker-9")


@pytest.fixture
def reconstruction(server, http, ledger, scan_with_alines):
    """A reconstruction that has succeeded and left a small volume."""
    made = http.post("/reconstructions", json={"scan_id": scan_with_alines["scan"]["id"], "parameters": {"modes": 4}})
    job_id = made.json()["id"]
    folder = server.data.job(job_id)
    folder.root.mkdir(parents=True)
    write_volume(folder.volume, volume(), parameters={}, provenance={})
    succeed(server, ledger, job_id, shape=[4, 4, 8])
    return job_id


LINE = {"start": [0, 0, 0], "end": [1, 0, 0]}


def asked(kind, reconstruction, scan_id, upload=""):
    return {
        "sound-speed": {"kind": kind, "scan_id": scan_id, "first": 1400, "last": 1600, "parameters": {"modes": 16}},
        "quality": {"kind": kind, "reconstruction_id": reconstruction, "reference_id": reconstruction},
        "width": {
            "kind": kind,
            "scan_id": scan_id,
            "reconstruction_id": reconstruction,
            "start": [0, 0, 0],
            "end": [1, 0, 0],
        },
        "export": {"kind": kind, "reconstruction_id": reconstruction, "format": "nrrd"},
        "import": {"kind": kind, "upload_id": upload, "labels": {"from": "elsewhere"}},
    }[kind]


def test_idempotent_repeat_keeps_first_request_id(server, http, scan_with_alines):
    scan, vary = scan_with_alines["scan"]["id"], {"sound_speed": [1480.0, 1500.0]}
    about = {"Idempotency-Key": uuid.uuid4().hex}

    def ask(path, **body):
        names = ({"X-Request-ID": name} for name in ("first-1", "again-1"))
        answers = [http.post(path, json=body, headers=about | name) for name in names]
        assert answers[1].headers["x-request-id"] == "again-1"
        assert answers[0].json() == answers[1].json(), "it is the first one's answer"
        return answers[0].json()

    image = ask("/reconstructions", scan_id=scan, parameters={"modes": 4})
    speeds = ask("/jobs", **asked("sound-speed", "", scan))
    batch = ask("/batches", scan_id=scan, vary=vary, parameters={"modes": 4})
    again = ask("/scans", plan_id=scan_with_alines["scan"]["plan_id"])
    shown = [f"/jobs/{job['id']}" for job in (image, speeds, *batch["jobs"])]
    shown += [f"/reconstructions/{image['id']}", f"/scans/{again['id']}"]
    assert {path: http.get(path).json()["request_id"] for path in shown} == dict.fromkeys(shown, "first-1")


def test_request_id_of_older_rows_is_null(server, http, plan, scan_with_alines):
    body = {"scan_id": scan_with_alines["scan"]["id"], "parameters": {"modes": 4}}
    image = http.post("/reconstructions", json=body).json()["id"]
    key = {"Idempotency-Key": uuid.uuid4().hex}
    scan = http.post("/scans", json={"plan_id": plan["id"]}, headers=key).json()["id"]
    with server.database.write() as session:  # before anybody reads them
        session.execute(update(JobRow).where(JobRow.id == image).values(request_id=None))
        session.execute(update(ScanRow).where(ScanRow.id == scan).values(request_id=None))
    for path in (f"/jobs/{image}", f"/reconstructions/{image}", f"/scans/{scan}"):
        assert http.get(path).json()["request_id"] is None


def kept(request):
    """A request that requires nothing of its worker, as it is stored."""
    whole = request.model_dump(mode="json")
    assert whole.pop("requires") == {"memory": None, "cores": None}
    return whole


@pytest.mark.parametrize("kind", ["sound-speed", "quality", "width", "export", "import"])
def test_a_job_is_queued_once_shown_moved_and_cancelled(http, reconstruction, scan_with_alines, kind):
    upload = http.post("/uploads", content=b"anything").json()["id"]
    body = asked(kind, reconstruction, scan_with_alines["scan"]["id"], upload)
    key = {"Idempotency-Key": uuid.uuid4().hex}
    made = http.post("/jobs", json=body, headers=key)
    job = made.json()
    assert (made.status_code, job["kind"], job["state"]) == (202, kind, "queued")
    assert http.post("/jobs", json=body, headers=key).json()["id"] == job["id"]
    here = made.headers["location"].removeprefix("/api/v1")
    assert job["asked"] == kept(JOB_TYPES[kind].request.create(**body)), "the request is kept as it came"
    assert job["id"] in [item["id"] for item in http.get("/jobs", params={"kind": kind}).json()["items"]]
    assert all(item["kind"] == kind for item in http.get("/jobs", params={"kind": kind}).json()["items"])
    seen = http.get(here)
    assert http.get(here, headers={"If-None-Match": seen.headers["etag"]}).status_code == 304
    moved = http.patch(here, json={"priority": 1}, headers={"If-Match": seen.headers["etag"]})
    assert (moved.status_code, moved.json()["priority"]) == (200, 1)
    late = http.patch(here, json={"priority": 2}, headers={"If-Match": seen.headers["etag"]})
    assert (late.status_code, late.json()["code"]) == (412, "precondition-failed")
    assert http.get(f"{here}/attempts").json() == {"items": []}
    assert http.get(f"{here}/log").text == ""
    early = http.get(f"{here}/files/x")
    assert (early.status_code, early.json()["code"]) == (409, "not-ready")
    gone = http.put(f"{here}/desired-state", json={"state": "cancelled", "reason": "typo"})
    assert (gone.json()["state"], gone.json()["reason"]) == ("cancelled", "typo")


@pytest.mark.parametrize(
    ("kind", "more"),
    [
        ("reconstruction", {"frame": 0}),
        ("live", {"follow": True, "interval": 1.5}),
        ("what-if", {"through": {"mask_id": "", "points": "exact"}}),
    ],
)
def test_reconstruction_request_is_stored_unchanged_in_job_ledger(http, ledger, scan_with_alines, mask, kind, more):
    if "through" in more:
        more["through"]["mask_id"] = mask["id"]
    body = {"scan_id": scan_with_alines["scan"]["id"], "parameters": {"modes": 4}, "priority": 7, **more}
    made = http.post("/reconstructions", json=body).json()
    row = ledger.get(made["id"])
    assert (made["kind"], row.kind, row.priority) == (kind, kind, 7)
    whole = JOB_TYPES[kind].request.create(**body)
    assert JOB_TYPES[kind].request.create(**forms.current(row.payload)) == whole
    assert row.payload["form"] == forms.FORM
    assert http.get(f"/jobs/{made['id']}").json()["asked"] == forms.asked(row.payload) == kept(whole)


def test_a_waiting_reconstruction_is_moved_only_if_it_is_as_the_caller_saw_it(http, scan_with_alines):
    made = http.post("/reconstructions", json={"scan_id": scan_with_alines["scan"]["id"], "parameters": {"modes": 8}})
    here = f"/reconstructions/{made.json()['id']}"
    seen = {"If-Match": http.get(here).headers["etag"]}
    assert http.patch(here, json={"priority": 3}, headers=seen).status_code == 200
    assert http.patch(here, json={"priority": 4}, headers=seen).status_code == 412
    assert http.get(here).json()["priority"] == 3


CASES = [
    ({}, "#/kind", "sound-speed, quality, width, regions, figure, export, import"),
    ({"kind": "dance"}, "#/kind", "'export'"),
    ({"kind": "export", "format": "nrrd"}, "#/reconstruction_id", "not both"),
    ({"kind": "export", "reconstruction_id": "r1", "scan_id": "s1", "format": "nrrd"}, "#/reconstruction_id", "both"),
    ({"kind": "export", "scan_id": "s1", "format": "nrrd"}, "#/format", "ipasc"),
    ({"kind": "export", "reconstruction_id": "r1", "format": "docx"}, "#/format", "nifti"),
    ({"kind": "export", "reconstruction_id": "../x", "format": "nrrd"}, "#/reconstruction_id", ""),
    ({"kind": "sound-speed", "scan_id": "s1", "first": 1500, "last": 1400}, "#/last", "> first"),
    ({"kind": "sound-speed", "scan_id": "s1", "first": 1, "last": 1400}, "#/first", "at least 300"),
    ({"kind": "quality", "reconstruction_id": "r1", "reference_id": "r1", "threshold": 2}, "#/threshold", "< 1"),
    (
        {"kind": "width", "scan_id": "s1", "reconstruction_id": "r1", "start": [1, 0, 0], "end": [1, 0, 0]},
        "#/end",
        "start",
    ),
    ({"kind": "import", "upload_id": "u1", "description": {"positions": "/etc/passwd"}}, "", "companion_id"),
]


@pytest.mark.parametrize(("body", "pointer", "words"), CASES, ids=str)
def test_invalid_job_returns_422_with_field_and_allowed_values(http, body, pointer, words):
    answer = http.post("/jobs", json=body)
    error = answer.json()["errors"][0]
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid-input")
    assert error["pointer"].endswith(pointer)
    assert words in error["allowed"]


def test_a_log_of_any_size_takes_little_memory(server, http):
    upload = http.post("/uploads", content=b"anything").json()["id"]
    job = http.post("/jobs", json={"kind": "import", "upload_id": upload}).json()["id"]
    log, size = server.data.job(job).log, 2**28
    log.parent.mkdir(parents=True)
    log.write_bytes(b"begun\n")
    assert http.get(f"/jobs/{job}/log").text == "begun\n"
    os.truncate(log, size)
    before = resident(server.process.pid)
    with http.stream("GET", f"/jobs/{job}/log") as answer:
        assert next(answer.iter_bytes()).startswith(b"begun")
        assert resident(server.process.pid) - before < size / 4


@pytest.mark.parametrize(
    ("body", "status", "code"),
    [
        ({"kind": "export", "reconstruction_id": "none", "format": "nrrd"}, 404, "not-found"),
        ({"kind": "export", "scan_id": "none", "format": "ipasc"}, 404, "not-found"),
        ({"kind": "sound-speed", "scan_id": "none", "first": 1400, "last": 1500}, 404, "not-found"),
        ({"kind": "import", "upload_id": "none"}, 404, "not-found"),
        ({"kind": "quality", "reconstruction_id": "none", "reference_id": "none"}, 404, "not-found"),
    ],
    ids=lambda value: value["kind"] if isinstance(value, dict) else "",
)
def test_a_job_about_nothing_is_refused(http, body, status, code):
    answer = http.post("/jobs", json=body)
    assert (answer.status_code, answer.json()["code"]) == (status, code)


def test_width_in_an_image_of_another_scan_is_refused_by_the_scan_s_name(http, reconstruction, scan):
    answer = http.post("/jobs", json=asked("width", reconstruction, scan["id"]))
    assert (answer.status_code, answer.json()["errors"][0]["pointer"]) == (422, "#/scan_id")


def test_export_of_unfinished_resource_returns_409_not_ready(http, scan, scan_with_alines):
    waiting = scan_with_alines["reconstruction"]["id"]
    answer = http.post("/jobs", json={"kind": "export", "reconstruction_id": waiting, "format": "nrrd"})
    assert (answer.status_code, answer.json()["code"], answer.json()["retryable"]) == (409, "not-ready", True)
    answer = http.post("/jobs", json={"kind": "export", "scan_id": scan["id"], "format": "ipasc"})
    assert (answer.status_code, answer.json()["code"]) == (409, "not-ready")


def test_images_of_other_voxels_are_not_compared(server, http, ledger, reconstruction, scan_with_alines):
    other = scan_with_alines["reconstruction"]["id"]
    folder = server.data.job(other)
    folder.root.mkdir(parents=True, exist_ok=True)
    write_volume(folder.volume, volume(side=6), parameters={}, provenance={})
    succeed(server, ledger, other, shape=[6, 6, 8])
    answer = http.post(f"/reconstructions/{reconstruction}/quality", json={"reference_id": other})
    assert (answer.status_code, answer.json()["errors"][0]["allowed"]) == (422, "one of [4, 4, 8] voxels")


def test_the_comparisons_of_a_reconstruction_stand_with_it(server, http, ledger, reconstruction):
    here = f"/reconstructions/{reconstruction}/quality"
    assert http.get(here).json() == {"items": []}
    made = http.post(here, json={"reference_id": reconstruction, "threshold": 0.1})
    assert made.status_code == 202
    assert http.get(here).json()["items"][0]["state"] == "queued"
    folder = server.data.job(made.json()["id"]).root
    folder.mkdir(parents=True)
    (folder / "quality.json").write_text(json.dumps({"volume_correlation": 0.5}))
    (folder / "secret.txt").write_text("not listed")
    succeed(server, ledger, made.json()["id"], figures={"volume_correlation": 0.5}, files=["quality.json"])
    (found,) = http.get(here).json()["items"]
    assert (found["figures"], found["threshold"], found["state"]) == ({"volume_correlation": 0.5}, 0.1, "succeeded")
    job = http.get(f"/jobs/{made.json()['id']}").json()
    assert job["files"] == ["quality.json"]
    path = job["links"]["file:quality.json"].removeprefix("/api/v1")
    assert http.get(path).json() == {"volume_correlation": 0.5}
    part = http.get(path, headers={"Range": "bytes=0-0"})
    assert (part.status_code, part.content) == (206, b"{")
    for name in ("secret.txt", "log.txt", "%2e%2e%2fx", "none"):
        assert http.get(f"/jobs/{job['id']}/files/{name}").status_code == 404, name


def test_job_list_contains_reconstruction_with_link(http, reconstruction):
    (job,) = [item for item in http.get("/jobs").json()["items"] if item["id"] == reconstruction]
    assert job["kind"] == "reconstruction"
    assert job["links"]["reconstruction"] == f"/api/v1/reconstructions/{reconstruction}"
    page = http.get("/jobs", params={"limit": 1, "kind": "reconstruction"})
    assert "kind=reconstruction" in page.headers["link"]


def test_a_scan_that_runs_can_be_followed_but_not_reconstructed_yet(http, scan):
    refused = http.post("/reconstructions", json={"scan_id": scan["id"]})
    assert refused.status_code == 409
    body = {"scan_id": scan["id"], "follow": True, "interval": 1, "parameters": {"modes": 16}}
    made = http.post("/reconstructions", json=body)
    job = made.json()
    assert (made.status_code, job["kind"]) == (202, "live")
    early = http.get(job["links"]["revision"].removeprefix("/api/v1"))
    assert (early.status_code, early.json()["code"]) == (409, "not-ready")


def test_the_newest_revision_is_shown_while_the_scan_runs(server, http, ledger, scan):
    made = http.post("/reconstructions", json={"scan_id": scan["id"], "follow": True, "parameters": {"modes": 16}})
    job_id = made.json()["id"]
    ledger.start_attempt(job_id, "worker-9")
    folder = server.data.job(job_id)
    folder.root.mkdir(parents=True)
    revision = {
        "number": 3, "points": 30, "planned": 69, "final": False, "coverage": {"points": 0.43}, "image": {},
        "quality": {"sharpness": 0.1, "correlation_with_previous": None}, "seconds": {"total": 0.1}, "weights": "…",
    }  # fmt: skip
    folder.revision.write_text(json.dumps(revision))
    (folder.root / "mip-z.png").write_bytes(b"\x89PNG")
    seen = http.get(f"/reconstructions/{job_id}/revision")
    assert (seen.json()["number"], seen.json()["quality"]["sharpness"]) == (3, 0.1)
    again = http.get(f"/reconstructions/{job_id}/revision", headers={"If-None-Match": seen.headers["etag"]})
    assert again.status_code == 304
    assert http.get(f"/reconstructions/{job_id}/mip").content == b"\x89PNG"
    assert http.get(f"/reconstructions/{job_id}/volume").status_code == 409, "that only when it is over"
    http.put(f"/jobs/{job_id}/desired-state", json={"state": "cancelled"}).raise_for_status()


@pytest.mark.parametrize(
    ("more", "pointer"),
    [
        ({"follow": True, "through": {"mask_id": "m1"}}, "#/through"),
        ({"follow": True, "frame": 0}, "#/frame"),
        ({"frame": 1}, "#/frame"),
        ({"frame": 0, "average": True}, "#/frame"),
        ({"wavelength": 8e-7}, "#/wavelength"),
        ({"follow": True, "average": True}, "#/average"),
        ({"follow": True, "interval": 0.01}, "#/interval"),
    ],
)
def test_a_reconstruction_that_contradicts_itself_or_its_scan_is_refused(http, scan_with_alines, more, pointer):
    answer = http.post(
        "/reconstructions", json={"scan_id": scan_with_alines["scan"]["id"], "parameters": {"modes": 8}, **more}
    )
    assert (answer.status_code, answer.json()["errors"][0]["pointer"]) == (422, pointer)


def test_mask_sweep_batch_creates_one_job_per_mask(http, scan_with_alines, mask):
    grid = {"arrangement": "grid", "aperture": 13.56e-3, "count": 5, "interval": 2e-3}
    masks = [mask["id"], http.post("/masks", json=grid).json()["id"]]
    body = {"scan_id": scan_with_alines["scan"]["id"], "vary": {"mask_id": masks}, "parameters": {"modes": 8}}
    batch = http.post("/batches", json=body).json()
    assert [job["varied"] for job in batch["jobs"]] == [{"mask_id": name} for name in masks]
    shown = http.get(f"/reconstructions/{batch['jobs'][1]['id']}").json()
    assert (shown["kind"], shown["mask_id"], shown["batch_id"]) == ("what-if", masks[1], batch["id"])
    assert http.put(f"/batches/{batch['id']}/desired-state", json={"state": "cancelled"}).json()["counts"] == {
        "cancelled": 2
    }
    small = http.post("/masks", json=grid | {"aperture": 12e-3}).json()["id"]
    refused = http.post("/batches", json=body | {"vary": {"mask_id": [small]}})
    assert "the scan's aperture" in refused.json()["detail"]


def test_all_wavelengths_of_a_scan_are_one_request(http, mask, server):
    from steradian.storage.repositories.scans import ScanRepository
    from steradian.storage.state_machines import ScanState

    body = {"mask_id": mask["id"], "samples": 256, "frames": 2, "excitation": [7e-7, 8e-7]}
    plan = http.post("/plans", json=body).json()
    made = http.post("/scans", json={"plan_id": plan["id"]}, headers={"Idempotency-Key": uuid.uuid4().hex})
    scan_id = made.json()["id"]
    scans = ScanRepository(server.database)
    for state in (ScanState.ARMING, ScanState.RUNNING, ScanState.COMPLETING, ScanState.COMPLETE):
        scans.transition(scan_id, state, why="test", summary={"points": 276, "stored": 276, "fired": 276})
    server.data.scan_file(scan_id).write_bytes(b"not read here")
    common = {"scan_id": scan_id, "parameters": {"modes": 8}}
    batch = http.post("/batches", json=common | {"each": "wavelength"}).json()
    assert [job["varied"] for job in batch["jobs"]] == [{"frame": 0}, {"frame": 2}]
    batch = http.post("/batches", json=common | {"each": "frame"}).json()
    assert len(batch["jobs"]) == 4


def test_upload_is_stored_unchanged_and_deletable(server, http):
    content = bytes(range(256)) * 300
    assert len(content) > server.settings.max_upload_bytes, "files may be larger than other bodies"
    made = http.post("/uploads", content=content)
    upload = made.json()
    assert (made.status_code, upload["bytes"]) == (201, len(content))
    assert server.data.upload(upload["id"]).read_bytes() == content
    assert zlib.crc32(content) == zlib.crc32(server.data.upload(upload["id"]).read_bytes())
    here = made.headers["location"].removeprefix("/api/v1")
    assert http.get(here).json()["bytes"] == len(content)
    for _ in range(2):
        assert http.delete(here).status_code == 204
    assert http.get(here).status_code == 404


@pytest.mark.parametrize("identifier", ["%2e%2e", "%2e%2e%2fsteradian.sqlite", "a.part", "none"])
def test_upload_invalid_identifier_is_rejected(http, identifier):
    assert http.get(f"/uploads/{identifier}").status_code in {404, 405}
    assert http.delete(f"/uploads/{identifier}").status_code in {204, 404, 405}
    assert http.get("/masks").status_code == 200, "and the database is where it was"


def test_an_empty_upload_or_one_beyond_the_limit_leaves_nothing(server, http):
    before = sorted(server.data.uploads.iterdir())
    assert http.post("/uploads", content=b"").status_code == 422
    far = str(server.settings.max_import_bytes + 1)
    with socket.create_connection(("127.0.0.1", http.base_url.port)) as line:
        line.sendall(f"POST /api/v1/uploads HTTP/1.1\r\nHost: localhost\r\nContent-Length: {far}\r\n\r\nx".encode())
        assert b" 413 " in line.recv(100)
    assert sorted(server.data.uploads.iterdir()) == before


@pytest.mark.long
def test_a_mask_has_a_picture_that_is_drawn_once(server, http, mask):
    here = mask["links"]["picture"].removeprefix("/api/v1")
    first = http.get(here)
    assert first.headers["content-type"] == "image/png"
    assert first.content.startswith(b"\x89PNG")
    assert http.get(here, headers={"If-None-Match": first.headers["etag"]}).status_code == 304
    assert server.data.picture(mask["id"]).read_bytes() == first.content
    assert http.get("/masks/none/picture").status_code == 404
