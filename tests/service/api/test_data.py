"""What was measured, in slices and formats; preconditions; the scanner's lease and emergency stop; batches."""

import io
import uuid

import httpx
import numpy as np
import pytest

from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import ScanState


def test_points_come_as_json_csv_and_npy(http, mask):
    path = f"/masks/{mask['id']}/points"
    listed = http.get(path).json()
    table = np.load(io.BytesIO(http.get(path, headers={"Accept": "application/x-npy"}).content))
    np.testing.assert_array_equal(table[:, :2], listed["positions"])
    text = http.get(path, headers={"Accept": "text/csv;q=0.9, image/png"})
    assert text.text.splitlines()[0] == "x_m,y_m,weight_m2"
    np.testing.assert_array_equal(np.loadtxt(io.StringIO(text.text), delimiter=",", skiprows=1), table)
    refused = http.get(path, headers={"Accept": "image/png"})
    assert (refused.status_code, refused.json()["code"]) == (406, "not-acceptable")
    assert "text/csv" in refused.json()["detail"]


@pytest.mark.parametrize("text", [None, "3", "0:5,10:20", ":,::7", "-2:,5", "1:4:2", "4:1", "0:5, 3"])
def test_a_slice_is_numpys(http, scan_with_alines, text):
    path = f"/scans/{scan_with_alines['scan']['id']}/alines"
    whole = np.load(io.BytesIO(http.get(path).content))
    expected = whole if text is None else eval(f"whole[{text}]")  # noqa: S307 - the claim is that it is the same
    for accept in ("application/x-npy", "application/octet-stream", "application/json"):
        answer = http.get(path, params={"slice": text} if text else {}, headers={"Accept": accept})
        assert answer.headers["x-shape"] == ",".join(map(str, expected.shape))
        if accept == "application/x-npy":
            found = np.load(io.BytesIO(answer.content))
        elif accept == "application/json":
            found = np.array(answer.json()["values"], np.int16).reshape(expected.shape)
        else:
            found = np.frombuffer(answer.content, answer.headers["x-dtype"]).reshape(expected.shape)
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("text", ["::0", "::-1", "1,2,3", "a", "9999", "...", "1.5", "0:2:", "٣"])
def test_a_slice_that_is_none_is_refused(http, scan_with_alines, text):
    answer = http.get(f"/scans/{scan_with_alines['scan']['id']}/alines", params={"slice": text})
    if text == "0:2:":
        assert answer.status_code == 200
    else:
        assert (answer.status_code, answer.json()["code"]) == (422, "invalid-input")


def test_shots_and_coverage_account_for_every_point(http, scan_with_alines):
    here = f"/scans/{scan_with_alines['scan']['id']}"
    shots = http.get(f"{here}/shots").json()
    assert [point for point, stored in enumerate(shots["stored"]) if stored] == sorted(scan_with_alines["visit"][:5])
    assert sorted(shots["shot"])[-5:] == [1, 2, 3, 4, 5]
    assert http.get(f"{here}/shots", params={"points": "3:5"}).json()["points"] == [3, 4]
    coverage = http.get(f"{here}/coverage").json()
    assert (coverage["points"], coverage["stored"], coverage["missing"], coverage["fired"]) == (53, 5, 48, 5)
    assert 0 < coverage["area_fraction"] < 0.5


def test_get_with_matching_if_none_match_returns_304(http, scan_with_alines, mask):
    scan_id = scan_with_alines["scan"]["id"]
    for path in (f"/scans/{scan_id}", f"/scans/{scan_id}/file", f"/masks/{mask['id']}", "/scanners/scanner-0"):
        first = http.get(path)
        again = http.get(path, headers={"If-None-Match": first.headers["etag"]})
        assert (again.status_code, again.content) == (304, b""), path
        assert again.headers["etag"] == first.headers["etag"]
        assert http.get(path, headers={"If-None-Match": '"other"'}).status_code == 200


def test_label_change_with_stale_if_match_returns_412(http, scan):
    here = f"/scans/{scan['id']}"
    seen = {"If-Match": http.get(here).headers["etag"]}
    changed = http.patch(here, json={"labels": {"phantom": "yarn", "by": "Ada"}}, headers=seen)
    assert changed.json()["labels"] == {"phantom": "yarn", "by": "Ada"}
    late = http.patch(here, json={"labels": {"phantom": "leaf"}}, headers=seen)
    assert (late.status_code, late.json()["code"]) == (412, "precondition-failed")
    assert http.patch(here, json={"labels": {"by": None}}).json()["labels"] == {"phantom": "yarn"}
    late = http.put(f"{here}/desired-state", json={"state": "aborted"}, headers=seen)
    assert late.status_code == 412, "it cannot hit what the caller has not seen"


def test_one_operator_at_a_time(http, plan):
    def scan(**headers):
        key = {"Idempotency-Key": uuid.uuid4().hex}
        return http.post("/scans", json={"plan_id": plan["id"]}, headers=key | headers)

    here = "/scanners/scanner-0/lease"
    mine = http.put(here, json={"holder": "Ada", "seconds": 60}).json()["lease"]
    refused = http.put(here, json={"holder": "Bob"})
    assert (refused.status_code, refused.json()["code"]) == (409, "lease-held")
    assert scan().json()["code"] == "lease-held"
    assert scan(**{"Scanner-Lease": str(mine["fence"] - 1)}).status_code == 409
    made = scan(**{"Scanner-Lease": str(mine["fence"])}).json()
    assert made["fence"] == mine["fence"]
    assert http.put(here, json={"holder": "Ada", "seconds": 90}).json()["lease"]["fence"] == mine["fence"]
    assert http.delete(here, headers={"Scanner-Lease": str(mine["fence"])}).status_code == 204
    assert http.put(here, json={"holder": "Bob"}).json()["lease"]["fence"] == mine["fence"] + 1
    old = scan(**{"Scanner-Lease": str(mine["fence"])})
    assert old.status_code == 409, "an old holder's request that arrives late does not fire"
    assert http.delete(here, headers={"Scanner-Lease": str(mine["fence"] + 1)}).status_code == 204


def test_release_with_older_stop_number_returns_409(http):
    here = "/scanners/scanner-0/emergency-stop"
    seen = http.post(here, json={"reason": "smoke"}).json()["emergency_stop"]
    later = http.post(here, json={"reason": "fire"}).json()["emergency_stop"]
    refused = http.delete(here, params={"number": seen["number"]})
    assert (refused.status_code, refused.json()["code"]) == (409, "emergency-stopped")
    assert http.get("/scanners/scanner-0").json()["emergency_stop"]["reason"] == "fire"
    assert http.delete(here, params={"number": later["number"]}).json()["emergency_stop"] is None


def test_the_body_of_an_emergency_stop_holds_four_kilobytes(http):
    answer = http.post("/scanners/scanner-0/emergency-stop", json={"reason": "x" * 5000})
    assert (answer.status_code, answer.json()["code"]) == (413, "too-large")


def test_the_emergency_stop_needs_no_lease_and_holds_until_it_is_released(http, plan, scan):
    here = "/scanners/scanner-0/emergency-stop"
    http.put("/scanners/scanner-0/lease", json={"holder": "Ada", "seconds": 60})
    for _ in range(2):
        stopped = http.post(here, json={"reason": "smoke"})
        assert (stopped.status_code, stopped.json()["emergency_stop"]["reason"]) == (202, "smoke")
    wished = http.get(f"/scans/{scan['id']}").json()
    assert (wished["desired_state"], wished["reason"]) == ("aborted", "emergency stop: smoke")
    key = {"Idempotency-Key": uuid.uuid4().hex}
    refused = http.post("/scans", json={"plan_id": plan["id"]}, headers=key)
    assert (refused.status_code, refused.json()["code"]) == (409, "emergency-stopped")
    assert http.delete(here).json()["emergency_stop"] is None
    fence = http.get("/scanners/scanner-0").json()["lease"]["fence"]
    http.delete("/scanners/scanner-0/lease", headers={"Scanner-Lease": str(fence)})
    assert http.post("/scans", json={"plan_id": plan["id"]}, headers=key).status_code == 201


def test_a_scan_without_an_idempotency_key_is_refused(http, plan):
    answer = http.post("/scans", json={"plan_id": plan["id"]})
    assert (answer.status_code, answer.json()["errors"][0]["place"]) == (422, "header")


def test_a_preview_stores_nothing(http, mask):
    body = {"mask_id": mask["id"], "pulse_rate": 12.5, "samples": 321}
    before = http.get("/plans").json()
    assert http.post("/plans/preview", json=body).json()["bytes"] == mask["count"] * 321 * 2
    assert http.get("/plans").json() == before


def test_a_batch_is_a_job_for_each_combination_and_one_summary(http, scan_with_alines):
    body = {
        "scan_id": scan_with_alines["scan"]["id"],
        "vary": {"sound_speed": [1480, 1500], "weights": ["mask", "uniform"]},
        "parameters": {"modes": 16},
    }
    made = http.post("/batches", json=body, headers={"Idempotency-Key": "b"})
    batch = made.json()
    assert (made.status_code, batch["state"], batch["counts"]) == (202, "queued", {"queued": 4})
    varied = [tuple(job["varied"].values()) for job in batch["jobs"]]
    assert varied == [(1480, "mask"), (1480, "uniform"), (1500, "mask"), (1500, "uniform")]
    assert http.post("/batches", json=body, headers={"Idempotency-Key": "b"}).json() == batch
    job = http.get(f"/reconstructions/{batch['jobs'][1]['id']}").json()
    assert (job["batch_id"], job["parameters"]["modes"]) == (batch["id"], 16)
    here = f"/batches/{batch['id']}"
    assert http.put(f"{here}/desired-state", json={"state": "cancelled"}).json()["state"] == "cancelled"
    assert http.get(here).json()["counts"] == {"cancelled": 4}


@pytest.mark.parametrize("vary", [{"nonsense": [1]}, {"modes": []}, {"modes": [1]}, {"modes": list(range(2, 300))}])
def test_a_batch_that_cannot_work_queues_nothing(http, scan_with_alines, vary):
    before = http.get("/reconstructions").json()
    answer = http.post("/batches", json={"scan_id": scan_with_alines["scan"]["id"], "vary": vary})
    assert answer.status_code == 422
    assert http.get("/reconstructions").json() == before


def test_a_waiting_reconstruction_can_be_moved_in_the_queue(http, scan_with_alines):
    identifier = scan_with_alines["reconstruction"]["id"]
    here, job = f"/reconstructions/{identifier}", f"/jobs/{identifier}"
    assert http.patch(here, json={"priority": 1}).json()["priority"] == 1
    assert http.get(f"{job}/attempts").json() == {"items": []}
    http.put(f"{job}/desired-state", json={"state": "cancelled"}).raise_for_status()
    assert http.patch(here, json={"priority": 2}).status_code == 409
    history = http.get(here).json()["history"]
    assert [entry["state"] for entry in history] == ["queued", "cancelling", "cancelled"]
    assert all(entry["who"] == "local" and entry["why"] and entry["at"] for entry in history)


def test_metrics_count_jobs_scans_and_requests(server, http, scan):
    http.get("/scans/none")
    text = httpx.get(f"{server.url}/metrics", timeout=250).text
    assert 'steradian_scans{state="queued"}' in text
    assert 'steradian_jobs{state="queued"}' in text
    assert 'route="/api/v1/scans/{scan_id}",status="404"' in text
    assert ScanRepository(server.database).counts()[ScanState.QUEUED] >= 1
