"""Route × header: every address that can be read keeps each convention that it declares, and declares what it keeps."""

import base64
import hashlib
import json
from pathlib import Path

import httpx
import numpy as np
import pytest

from steradian.imaging import Volume, VoxelAxes
from steradian.jobs.job import Succeeded
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.reconstructions.volumes.file import write_volume
from steradian.storage.repositories.scans import ScanRepository

from .conftest import EQUI, PLAIN, make_plan, make_scan_with_alines

DOCUMENT = json.loads((Path(__file__).parents[3] / "docs" / "openapi.json").read_text())
V1 = "/api/v1"
TAG, RANGE, ACCEPT, PREFER = "tag", "range", "accept", "prefer"
READS = {
    "/healthz": set(),
    "/readyz": set(),
    "/metrics": set(),
    V1: set(),
    f"{V1}/storage": set(),
    f"{V1}/session": set(),
    f"{V1}/masks": set(),
    f"{V1}/masks/{{mask_id}}": {TAG},
    f"{V1}/masks/{{mask_id}}/points": {TAG, ACCEPT},
    f"{V1}/masks/{{mask_id}}/picture": {TAG, RANGE},
    f"{V1}/plans": set(),
    f"{V1}/plans/{{plan_id}}": {TAG},
    f"{V1}/scanners": set(),
    f"{V1}/scanners/{{scanner_id}}": {TAG},
    f"{V1}/emergency-stop": set(),
    f"{V1}/scans": set(),
    f"{V1}/scans/{{scan_id}}": {TAG, PREFER},
    f"{V1}/scans/{{scan_id}}/file": {TAG, RANGE, PREFER},
    f"{V1}/scans/{{scan_id}}/shots": set(),
    f"{V1}/scans/{{scan_id}}/signals": {TAG},
    f"{V1}/scans/{{scan_id}}/alines": {TAG, ACCEPT},
    f"{V1}/scans/{{scan_id}}/alines/latest": {TAG, ACCEPT},
    f"{V1}/scans/{{scan_id}}/coverage": set(),
    f"{V1}/reconstructions": set(),
    f"{V1}/reconstructions/{{reconstruction_id}}": {TAG, PREFER},
    f"{V1}/reconstructions/{{reconstruction_id}}/mip": {TAG, ACCEPT, PREFER},
    f"{V1}/reconstructions/{{reconstruction_id}}/volume": {TAG, ACCEPT, PREFER},
    f"{V1}/reconstructions/{{reconstruction_id}}/volume.ome.zarr/{{path}}": {TAG, PREFER},
    f"{V1}/reconstructions/{{reconstruction_id}}/measurements": {TAG, ACCEPT},
    f"{V1}/reconstructions/{{reconstruction_id}}/quality": set(),
    f"{V1}/reconstructions/{{reconstruction_id}}/revision": {TAG},
    f"{V1}/batches": set(),
    f"{V1}/batches/{{batch_id}}": set(),
    f"{V1}/uploads/{{upload_id}}": set(),
    f"{V1}/jobs": set(),
    f"{V1}/jobs/{{job_id}}": {TAG, PREFER},
    f"{V1}/jobs/{{job_id}}/attempts": set(),
    f"{V1}/jobs/{{job_id}}/log": set(),
    f"{V1}/jobs/{{job_id}}/files/{{name}}": {TAG, RANGE, PREFER},
    f"{V1}/events": set(),
}
"""Every address that can be read, and what it knows: ETags with If-None-Match and If-Match, Range, Accept, Prefer."""
CHANGES = ("scan_change", "scan_desired_state_set", "job_change", "reconstruction_change")
"""Operations that take If-Match."""
WAITS = ("scan_create", "reconstruction_create", "job_create", "reconstruction_quality_create")
"""Operations that make something and may wait for it."""
REVISION = {"number": 1, "points": 5, "planned": 9, "final": True}
REVISION |= {"coverage": {}, "quality": {}, "image": {"shape": [4, 4, 8], "spacing_m": [1, 1, 1]}, "seconds": {}}


def declared(operation):
    return {parameter["name"] for parameter in operation.get("parameters", ())}


@pytest.fixture(scope="module")
def names(server, http):
    """One of each thing, every file of theirs written; no test changes any of them."""
    mask = http.post("/masks", json=EQUI).json()
    plan = make_plan(http, mask["id"])
    scan_id = make_scan_with_alines(server, http, plan["id"])["scan"]["id"]
    made = http.post("/reconstructions", json={"scan_id": scan_id, "parameters": {"modes": 4}}).json()["id"]
    folder = server.data.job(made)
    folder.root.mkdir(parents=True)
    axes = VoxelAxes(np.arange(4) * 1e-3, np.arange(4) * 1e-3, np.arange(8) * 1e-4)
    values = np.random.default_rng(1).normal(size=(4, 4, 8)).astype(np.float32)
    write_volume(folder.volume, Volume(values, axes, (1e-3, 1e-3, 1e-4)), parameters={}, provenance={})
    (folder.root / "mip-z.png").write_bytes(b"a picture")
    folder.revision.write_text(json.dumps(REVISION))
    folder.log.write_text("a line\n")
    ledger = JobLedger(server.database)
    ledger.start_attempt(made, "worker-9")
    ledger.finish_attempt(made, 1, Succeeded({"shape": [4, 4, 8], "files": [folder.volume.name]}), "worker-9")
    batch = http.post("/batches", json={"scan_id": scan_id, "vary": {"modes": [4, 8]}}).json()["id"]
    found = {"mask_id": mask["id"], "plan_id": plan["id"], "scan_id": scan_id, "scanner_id": "scanner-0"}
    found |= {
        "reconstruction_id": made,
        "job_id": made,
        "number": 2,
        "batch_id": batch,
        "name": folder.volume.name,
        "path": "zarr.json",
    }
    return found | {"upload_id": http.post("/uploads", content=b"x").json()["id"]}


def test_convention_table_matches_openapi_document():
    told = {path: operations["get"] for path, operations in DOCUMENT["paths"].items() if "get" in operations}
    assert set(READS) == set(told)
    for path, operation in told.items():
        sent = declared(operation)
        assert ({"If-None-Match", "If-Match"} <= sent) is (TAG in READS[path]), path
        assert ("304" in operation["responses"]) is (TAG in READS[path]), path
        assert ({"Range", "If-Range", "Want-Repr-Digest"} <= sent) is (RANGE in READS[path]), path
        assert ("Prefer" in sent) is (PREFER in READS[path]), path
        assert (len(operation["responses"]["200"]["content"]) > 1) is (ACCEPT in READS[path]), path
    operations = [one for path in DOCUMENT["paths"].values() for method, one in path.items() if method != "get"]
    assert {one["operationId"] for one in operations if "If-Match" in declared(one)} == {
        *CHANGES,
        "reconstruction_measurements_set",  # of a volume: see test_measurements
    }
    assert {one["operationId"] for one in operations if "Prefer" in declared(one)} == set(WAITS)


@pytest.mark.parametrize("path", READS)
def test_get_route_follows_declared_http_conventions(server, names, path):
    with httpx.Client(base_url=server.url, verify=PLAIN, timeout=250) as client:
        address, known = path.format(**names), READS[path]
        check_head(client, address)
        if path.endswith("/events"):
            return  # a stream
        answer = client.get(address)
        assert answer.headers["x-request-id"], path
        assert answer.headers["cache-control"] == ("private, no-cache" if TAG in known else "no-store"), path
        assert ("etag" in answer.headers) is (TAG in known), path
        if TAG in known:
            check_tags(client, address, answer)
        if RANGE in known:
            check_ranges(client, address, answer)
        if ACCEPT in known:
            check_representations(client, address, DOCUMENT["paths"][path]["get"])
        if PREFER in known:
            held = client.get(address, headers={"Prefer": "respond-async, wait=1"})
            assert held.headers["preference-applied"] == "wait=1", path


def check_head(client, address):
    """HEAD says what GET would, without the body."""
    head = client.head(address)
    assert head.content == b""
    if address.endswith("/events"):
        assert head.status_code == 200
        return
    full = client.get(address)
    assert head.status_code == full.status_code
    changing = {"date", "x-request-id"} | ({"content-length"} if address == "/metrics" else set())
    told = [{k: v for k, v in one.headers.items() if k not in changing} for one in (head, full)]
    assert told[0] == told[1]


def check_tags(client, address, answer):
    """A tag spares the body, also as a weak one; another one does not; If-Match refuses what has changed."""
    etag = answer.headers["etag"]
    for sent in (etag, f"W/{etag}", f'"other", W/{etag}', "*"):
        same = client.get(address, headers={"If-None-Match": sent})
        assert (same.status_code, same.content, same.headers["etag"]) == (304, b"", etag), sent
        assert same.headers.get("vary") == answer.headers.get("vary")
    assert client.get(address, headers={"If-None-Match": '"other"'}).status_code == 200
    for sent in (etag, f'"other", {etag}', "*"):
        assert client.get(address, headers={"If-Match": sent}).status_code == 200, sent
    for sent in ('"other"', f"W/{etag}"):
        refused = client.get(address, headers={"If-Match": sent})
        assert (refused.status_code, refused.json()["code"]) == (412, "precondition-failed"), sent


def check_ranges(client, address, answer):
    """A range is a part of the whole; If-Range takes the whole when it is another one now."""
    size, etag = len(answer.content), answer.headers["etag"]
    assert answer.headers["accept-ranges"] == "bytes"
    part = client.get(address, headers={"Range": "bytes=2-5", "If-Range": etag})
    assert (part.status_code, part.content) == (206, answer.content[2:6])
    assert part.headers["content-range"] == f"bytes 2-5/{size}"
    assert part.headers["etag"] == etag
    assert client.get(address, headers={"Range": "bytes=2-5", "If-Range": '"other"'}).content == answer.content
    digest = f"sha-256=:{base64.b64encode(hashlib.sha256(answer.content).digest()).decode()}:"
    for asked in ({}, {"Range": "bytes=2-5"}):
        told = client.get(address, headers={"Want-Repr-Digest": "sha-256=1"} | asked)
        assert told.headers["repr-digest"] == digest, "of the whole, also beside a part"
    beyond = client.get(address, headers={"Range": f"bytes={size}-"})
    assert (beyond.status_code, beyond.headers["content-range"]) == (416, f"bytes */{size}")
    assert beyond.json()["code"] == "range-not-satisfiable"
    for condition in ({"If-None-Match": etag}, {"If-Match": '"other"'}):
        assert client.get(address, headers={"Range": "bytes=2-5"} | condition).status_code in (304, 412)


def check_representations(client, address, operation):
    """Each representation is had by its name, has a tag of its own, and gives way as RFC 9110 says."""
    kinds, tags = list(operation["responses"]["200"]["content"]), set()
    for kind in kinds:
        answer = client.get(address, headers={"Accept": kind})
        assert answer.headers["content-type"].partition(";")[0] == kind
        assert answer.headers["vary"] == "Accept"
        tags.add(answer.headers["etag"])
        other = client.get(address, headers={"Accept": f"{kind};q=0, */*"})
        assert other.headers["content-type"].partition(";")[0] != kind, "q=0 is a no, whatever the rest allows"
        least = client.get(address, headers={"Accept": f"*/*;q=0.9, {kind};q=0.1"})
        assert least.headers["content-type"].partition(";")[0] != kind, "what is named says more than what is not"
        most = client.get(address, headers={"Accept": f"image/webp, */*;q=0.1, {kind};q=0.2"})
        assert most.headers["content-type"].partition(";")[0] == kind
        told = client.get(address, headers={"Accept": f"{kind}; charset=utf-8"})
        assert told.status_code == 200, "what some clients add says nothing about which of these it is"
    assert len(tags) == len(kinds)
    for accept in ("image/webp", "*/*;q=0"):
        refused = client.get(address, headers={"Accept": accept})
        assert (refused.status_code, refused.json()["code"]) == (406, "not-acceptable")


@pytest.mark.parametrize("name", CHANGES)
def test_change_with_stale_if_match_returns_412(http, scan, scan_with_alines, name):
    job = scan_with_alines["reconstruction"]["id"]
    here = {"scan_": f"/scans/{scan['id']}", "job_c": f"/jobs/{job}", "recon": f"/reconstructions/{job}"}[name[:5]]
    if name == "scan_desired_state_set":
        method, at, body = "PUT", f"{here}/desired-state", {"state": "aborted"}
    else:
        method, at = "PATCH", here
        body = {"labels": {"a": "b"}} if name == "scan_change" else {"priority": 3}
    before = http.get(here).headers["etag"]
    for sent in ('"other"', 'W/"other"', '"' + "9" * 5000 + '"', '""'):
        assert http.request(method, at, json=body, headers={"If-Match": sent}).status_code == 412
    changed = http.request(method, at, json=body, headers={"If-Match": f"W/{before}"})  # as a proxy's gzip makes it
    assert changed.status_code == 200
    assert changed.headers["etag"] == http.get(here).headers["etag"] != before
    for sent in (before, f"W/{before}"):
        late = http.request(method, at, json=body, headers={"If-Match": sent})
        assert (late.status_code, late.json()["code"]) == (412, "precondition-failed")
    assert http.request(method, at, json=body, headers={"If-Match": "*"}).status_code == 200


def test_progress_is_a_new_representation_but_no_change_that_others_made(server, http, scan, scan_with_alines):
    """Who labels a scan while it runs is not refused because it runs."""
    job = scan_with_alines["reconstruction"]["id"]
    ledger, scans = JobLedger(server.database), ScanRepository(server.database)
    ledger.start_attempt(job, "worker-9")
    for here, report in (
        (f"/scans/{scan['id']}", lambda done: scans.report(scan["id"], "A-lines", done, 9)),
        (f"/jobs/{job}", lambda done: ledger.report(job, 1, "reading", done, 9)),
    ):
        report(1)
        seen = http.get(here)
        report(2)
        later = http.get(here, headers={"If-None-Match": seen.headers["etag"]})
        assert (later.status_code, later.json()["progress"]["done"]) == (200, 2)
        if here.startswith("/scans"):
            sent = {"If-Match": seen.headers["etag"]}
            assert http.patch(here, json={"labels": {"a": "b"}}, headers=sent).status_code == 200


@pytest.mark.parametrize("name", WAITS)
def test_create_with_prefer_wait_returns_preference_applied(http, names, plan, name):
    at, body = {
        "scan_create": ("/scans", {"plan_id": plan["id"]}),
        "reconstruction_create": ("/reconstructions", {"scan_id": names["scan_id"], "parameters": {"modes": 4}}),
        "job_create": ("/jobs", {"kind": "export", "scan_id": names["scan_id"], "format": "ipasc"}),
        "reconstruction_quality_create": (
            f"/reconstructions/{names['reconstruction_id']}/quality",
            {"reference_id": names["reconstruction_id"]},
        ),
    }[name]
    made = http.post(at, json=body, headers={"Prefer": "wait=1", "Idempotency-Key": name + names["job_id"]})
    assert made.headers["preference-applied"] == "wait=1"
    assert made.status_code == (201 if name == "scan_create" else 202)
    assert http.get(made.headers["location"].removeprefix(V1)).json()["state"] == "queued"


def test_unsupported_method_returns_405_with_allow_header(server, names):
    """The Allow header of a refusal names every method of the address."""
    with httpx.Client(base_url=server.url, verify=PLAIN, timeout=250) as client:
        for path, operations in DOCUMENT["paths"].items():
            methods = {method.upper() for method in operations} | ({"HEAD"} if "get" in operations else set())
            refused = client.request("TRACE", path.format(**names))
            assert refused.status_code == 405, path
            allowed = set(refused.headers["allow"].split(", "))
            # a preview's address is also that of a thing called so, which there never is
            assert methods <= allowed if path.endswith("/preview") else methods == allowed, path
