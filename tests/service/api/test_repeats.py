"""What is asked again: the first answer comes back whatever has become of what it was about; first looks at once."""

import time
import uuid
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime

import h5py
import numpy as np
import pytest
from sqlalchemy import delete

from steradian.core.json_encoding import to_jsonable
from steradian.imaging import Volume, VoxelAxes
from steradian.jobs.job import Succeeded
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.reconstructions.volumes.file import write_volume
from steradian.storage.db.tables import JobRow
from steradian.storage.repositories.event_log import EventLog


def ask_twice(http, path, body, between):
    key = {"Idempotency-Key": uuid.uuid4().hex}
    first = http.post(path, json=body, headers=key)
    assert first.status_code in (201, 202), first.text
    between()
    again = http.post(path, json=body, headers=key)
    assert (again.status_code, again.text) == (first.status_code, first.text)
    assert again.headers["Idempotency-Replayed"] == "true"
    other = http.post(path, json=body | {"priority": 3}, headers=key)
    assert (other.status_code, other.json()["errors"][0]["pointer"]) == (422, "Idempotency-Key")


def test_a_repeated_import_gets_its_answer_when_the_upload_is_gone(server, http):
    upload = http.post("/uploads", content=b"anything").json()["id"]
    body = {"kind": "import", "upload_id": upload}
    ask_twice(http, "/jobs", body, server.data.upload(upload).unlink)


@pytest.mark.parametrize("path", ["/reconstructions", "/batches"])
def test_a_repeated_reconstruction_or_batch_gets_its_answer_when_the_scan_has_changed(
    server, http, scan_with_alines, path
):
    scan_id = scan_with_alines["scan"]["id"]
    body = {"scan_id": scan_id, "parameters": {"modes": 4}}
    if path == "/batches":
        body |= {"vary": {"sound_speed": [1480, 1500]}}
    ask_twice(http, path, body, server.data.scan_file(scan_id).unlink)


def test_batch_with_deleted_jobs_is_forgotten_not_queued(server, http, scan_with_alines):
    body = {"scan_id": scan_with_alines["scan"]["id"], "vary": {"modes": [4, 8]}}
    batch = http.post("/batches", json=body).json()
    names = [job["id"] for job in batch["jobs"]]
    ledger = JobLedger(server.database)
    for name in names:
        ledger.finish_attempt(name, ledger.start_attempt(name, "worker-9").fence, Succeeded({}), "worker-9")
    assert http.get(f"/batches/{batch['id']}").json()["state"] == "succeeded"
    seen = []
    for name in names:
        with server.database.write() as session:
            session.execute(delete(JobRow).where(JobRow.id == name))
        shown = http.get(f"/batches/{batch['id']}").json()
        seen.append((shown["state"], shown["counts"]))
    assert seen == [("succeeded", {"succeeded": 1, "forgotten": 1}), ("forgotten", {"forgotten": 2})]
    assert batch["id"] in [item["id"] for item in http.get("/batches").json()["items"]]


@pytest.mark.long
def test_concurrent_first_mask_picture_requests_draw_once(server, http):
    """Two that draw share a draft: the slower one would find it renamed, or write into what is being read."""
    arrangement = {"arrangement": "equi-steradian", "aperture": 0.012, "depth": 4e-3, "count": 333}
    mask = http.post("/masks", json=arrangement).json()
    path, versions = server.data.picture(mask["id"]), set()

    def look():
        answer = http.get(mask["links"]["picture"].removeprefix("/api/v1"))
        versions.add(path.stat().st_mtime_ns)
        return answer.status_code, answer.content

    with ThreadPoolExecutor(4) as pool:
        looks = [pool.submit(look) for _ in range(4)]
        while not all(one.done() for one in looks):
            if path.exists():
                versions.add(path.stat().st_mtime_ns)
            time.sleep(0.001)
    assert {one.result() for one in looks} == {(200, path.read_bytes())}
    assert len(versions) == 1


def events(lines, seconds=30.0):
    """Yield the fields of each event, with the time that may pass."""
    deadline, fields = time.monotonic() + seconds, {}
    for line in lines:
        assert time.monotonic() < deadline, "it did not come in time"
        name, _, value = line.partition(": ")
        if line:
            fields[name] = value
        elif fields:
            yield fields
            fields = {}


def test_filtered_event_stream_advances_id_past_filtered_events(server, http, scan_with_alines):
    log, wanted = EventLog(server.database), {"kind": "scan", "progress": False}
    with http.stream("GET", "/events", params=wanted) as answer:
        stream = events(answer.iter_lines())
        assert next(stream)["event"] == "ready"
        body = {"scan_id": scan_with_alines["scan"]["id"], "parameters": {"modes": 4}}
        http.post("/reconstructions", json=body).raise_for_status()
        last = log.bounds().last
        for event in stream:
            identifier = event.get("id", "")
            assert event.keys() <= {"id", ""}, "what others did is not sent"
            if int(identifier.rpartition(".")[2] or 0) >= last:
                break
    log.prune(datetime.now(UTC))
    with http.stream("GET", "/events", params=wanted, headers={"Last-Event-ID": identifier}) as answer:
        assert next(events(answer.iter_lines()))["event"] == "ready", "nothing was missed"


def test_json_response_encodes_non_finite_numbers_as_null(server, http, scan_with_alines):
    scan_id = scan_with_alines["scan"]["id"]
    shots = http.get(f"/scans/{scan_id}/shots").json()
    assert {value is None for value, stored in zip(shots["energy"], shots["stored"], strict=True) if stored} == {False}
    with h5py.File(server.data.scan_file(scan_id), "r+") as file:
        row = int(np.flatnonzero(file["alines/status"][:])[0])
        file["alines/energy"][row] = np.nan
    assert http.get(f"/scans/{scan_id}/shots").json()["energy"][row] is None
    made = http.post("/reconstructions", json={"scan_id": scan_id, "parameters": {"modes": 4}}).json()
    values = np.ones((2, 2, 3), np.float32)
    values[0, 0] = np.nan, np.inf, -2
    axes = VoxelAxes(np.arange(2) * 1e-3, np.arange(2) * 1e-3, np.arange(3) * 1e-4)
    folder = server.data.job(made["id"])
    folder.root.mkdir(parents=True)
    write_volume(folder.volume, Volume(values, axes, (1e-3, 1e-3, 1e-4)), parameters={}, provenance={})
    ledger = JobLedger(server.database)
    fence = ledger.start_attempt(made["id"], "worker-9").fence
    ledger.finish_attempt(made["id"], fence, Succeeded({"shape": [2, 2, 3]}), "worker-9")
    here = f"/reconstructions/{made['id']}/volume"
    answer = http.get(here, params={"slice": "0"}, headers={"Accept": "application/json"})
    assert answer.json()["values"] == [[None, None, -2.0], [1.0, 1.0, 1.0]]


def test_a_figure_that_is_no_number_is_null_in_a_jobs_result():
    found = to_jsonable({"a": float("nan"), "b": [np.float32("inf"), 1], "c": np.array([1.0, np.nan])})
    assert found == {"a": None, "b": [None, 1], "c": [1.0, None]}


def test_a_repeated_scan_gets_its_answer_when_the_laser_may_not_fire_any_more(http, plan):
    key, body = {"Idempotency-Key": uuid.uuid4().hex}, {"plan_id": plan["id"]}
    first = http.post("/scans", json=body, headers=key)
    http.post("/scanners/scanner-0/emergency-stop", json={"reason": "smoke"}).raise_for_status()
    try:
        again = http.post("/scans", json=body, headers=key)
    finally:
        assert http.delete("/scanners/scanner-0/emergency-stop").status_code == 200
    assert (again.status_code, again.text) == (201, first.text)
