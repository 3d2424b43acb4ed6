import threading
import time
import uuid

import httpx
import numpy as np
import pytest

from steradian.masks import equi_steradian_mask, hexagonal_interval, hexagonal_mask, with_point_of_interest
from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import ScanState


def new_scan(http, plan_id):
    return http.post("/scans", json={"plan_id": plan_id}, headers={"Idempotency-Key": uuid.uuid4().hex})


EQUI = {"arrangement": "equi-steradian", "aperture": 13.56e-3, "depth": 3.6e-3, "count": 60}


@pytest.mark.long
def test_root_describes_service_with_resolvable_links(server, http):
    root = http.get("/").json()
    assert (root["name"], root["mode"]) == ("steradian", "simulated")
    assert root["limits"]["mask_points"] == 5000
    for link in root["links"].values():
        with httpx.stream("GET", server.url + link, timeout=250) as answer:
            assert answer.status_code in (200, 503)


@pytest.mark.parametrize(
    "body",
    [
        EQUI | {"aperture": 0.0123},  # masks that no other test of this server makes
        {"arrangement": "grid", "aperture": 0.0123, "count": 3, "interval": 1e-3},
        {"arrangement": "points", "aperture": 0.0123, "positions": [[0, 0], [1e-3, 0]], "weights": [1, 2]},
    ],
    ids=lambda body: body["arrangement"],
)
def test_the_same_mask_is_made_once_and_has_one_address(http, body):
    first, second = http.post("/masks", json=body), http.post("/masks", json=body)
    assert (first.status_code, second.status_code) == (201, 200)
    assert first.json() == second.json()
    assert first.headers["location"] == second.headers["location"] == first.json()["links"]["self"]
    assert http.get(f"/masks/{first.json()['id']}").json() == first.json()


def test_mask_points_equal_library_points(http, mask):
    points = http.get(f"/masks/{mask['id']}/points").json()
    own = equi_steradian_mask(13.56e-3, 3.6e-3, 60)
    assert mask["id"] == points["id"] == own.id
    np.testing.assert_array_equal(points["positions"], own.positions)
    np.testing.assert_array_equal(points["weights"], own.weights)


def test_an_arrangement_is_asked_for_by_its_number_of_points_and_its_depth(http):
    """The same mask as that of the interval which gives the number, aimed afterwards."""
    wanted = {"aperture": 13.56e-3, "depth": 3.6e-3, "offset": [1e-3, 0]}
    made = http.post("/masks", json={"arrangement": "hexagonal", "count": 200} | wanted).json()
    own = with_point_of_interest(hexagonal_mask(13.56e-3, hexagonal_interval(13.56e-3, 200)), 3.6e-3, (1e-3, 0.0))
    assert (made["id"], made["count"]) == (own.id, own.count)
    scattered = http.post("/masks", json={"arrangement": "poisson-disc", "count": 200} | wanted).json()
    assert abs(scattered["count"] - 200) <= 1
    assert scattered["depth"] == 3.6e-3


@pytest.mark.parametrize(
    ("wrong", "field"),
    [
        ({"arrangement": "hexagonal", "interval": 1e-3, "count": 50}, "count"),
        ({"arrangement": "poisson-disc"}, "count"),
        ({"arrangement": "random", "count": 50, "offset": [1e-3, 0]}, "offset"),
        ({"arrangement": "random", "count": 50, "offset": [0.1, 0], "depth": 3e-3}, "offset"),
    ],
)
def test_mask_with_missing_or_conflicting_fields_returns_422(http, wrong, field):
    answer = http.post("/masks", json={"aperture": 0.01} | wrong)
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["pointer"].endswith(field), answer.json()


def test_the_same_plan_is_made_once_and_states_its_cost(http, mask):
    body = {"mask_id": mask["id"], "pulse_rate": 100, "samples": 300}
    first, second = http.post("/plans", json=body), http.post("/plans", json=body)
    assert (first.status_code, second.status_code) == (201, 200)
    plan = http.get(f"/plans/{first.json()['id']}").json()
    assert plan == first.json() == second.json()
    assert plan["preview"]["laser_seconds"] == pytest.approx(mask["count"] / 100)
    assert plan["preview"]["bytes"] == mask["count"] * 300 * 2


@pytest.mark.long
@pytest.mark.timeout(400)
def test_plan_with_tuning_map_reports_sensitivity_loss(http, mask):
    points = http.get(f"/masks/{mask['id']}/points").json()["positions"]
    best = (1.55e-6 + np.random.default_rng(0).uniform(-2e-9, 2e-9, len(points))).tolist()
    body = {"mask_id": mask["id"], "pulse_rate": 50, "samples": 300, "order": "bands", "max_sensitivity_loss": 0.1}
    body |= {"tuning_map": {"positions": points, "wavelengths": best}, "tuning": {"settling": 0.03, "speed": 1}}
    answer = http.post("/plans", json=body, timeout=300)  # the search is compiled, beside all else
    assert answer.status_code == 201, answer.text
    assert http.get(f"/plans/{answer.json()['id']}").json()["max_sensitivity_loss"] == 0.1
    cost = answer.json()["preview"]
    assert 0.05 < cost["sensitivity_loss"]["max"] <= 0.1
    assert cost["retunings"] == cost["bands"] - 1 < 40
    doubly = http.post("/plans", json=body | {"wavelengths": best})
    assert doubly.status_code == 422
    assert "wavelengths" in doubly.text


def test_new_scan_is_queued_and_marked_simulated(http, plan):
    answer = new_scan(http, plan["id"])
    scan = answer.json()
    assert answer.status_code == 201
    assert answer.headers["location"] == scan["links"]["self"]
    assert (scan["state"], scan["desired_state"], scan["simulated"]) == ("queued", "running", True)
    assert http.get(f"/scans/{scan['id']}").json() == scan


def test_a_repeated_idempotency_key_finds_the_same_scan(http, plan):
    key, body = {"Idempotency-Key": "try-1"}, {"plan_id": plan["id"]}
    first = http.post("/scans", json=body, headers=key)
    second = http.post("/scans", json=body, headers=key)
    assert first.json()["id"] == second.json()["id"]
    assert (first.status_code, second.status_code) == (201, 201)
    assert "idempotency-replayed" not in first.headers
    assert second.headers["idempotency-replayed"] == "true"
    other = http.post("/scans", json=body | {"plan_id": plan["id"] + "x"}, headers=key)
    assert other.status_code in (404, 422)
    assert other.json()["code"] in ("not-found", "invalid-input")
    assert new_scan(http, plan["id"]).json()["id"] != first.json()["id"]
    assert first.content == second.content


def test_lists_are_paged_and_every_scan_is_in_them_once(http, plan):
    made = [new_scan(http, plan["id"]).json()["id"] for _ in range(5)]
    seen, url = [], "/scans?limit=2"
    while url:
        answer = http.get(url)
        seen += [scan["id"] for scan in answer.json()["items"]]
        following = answer.links.get("next", {}).get("url")
        url = following and following.removeprefix("/api/v1")
    assert seen[:5] == made[::-1]
    assert len(seen) == len(set(seen))


def test_waiting_ends_when_the_scan_is_over(server, http, scan):
    def finish():
        time.sleep(0.3)
        scans = ScanRepository(server.database)
        for state in (ScanState.ARMING, ScanState.RUNNING, ScanState.COMPLETING, ScanState.COMPLETE):
            scans.transition(scan["id"], state, why="test")

    thread, start = threading.Thread(target=finish), time.monotonic()
    thread.start()
    answer = http.get(f"/scans/{scan['id']}", headers={"Prefer": "respond-async, wait=90"})
    thread.join()
    assert answer.json()["state"] == "complete"
    assert answer.headers["preference-applied"] == "wait=90"
    assert 0.2 < time.monotonic() - start < 60


def test_waiting_ends_after_the_time_that_was_asked_for(http, scan):
    start = time.monotonic()
    answer = http.get(f"/scans/{scan['id']}", headers={"Prefer": "wait=1"})
    assert answer.json()["state"] == "queued"
    assert 0.9 < time.monotonic() - start < 25


def test_a_client_that_leaves_while_it_waits_changes_nothing(http, scan):
    with pytest.raises(httpx.ReadTimeout):
        http.get(f"/scans/{scan['id']}", headers={"Prefer": "wait=60"}, timeout=0.3)
    assert http.get(f"/scans/{scan['id']}").json() == scan


def test_scan_desired_state_is_stored_and_idempotent(http, scan):
    for _ in range(2):
        answer = http.put(f"/scans/{scan['id']}/desired-state", json={"state": "stopped", "reason": "too warm"})
        assert answer.status_code == 200
        assert (answer.json()["desired_state"], answer.json()["reason"]) == ("stopped", "too warm")


def test_file_of_unfinished_scan_returns_409_with_retry_after(http, scan):
    for answer in (
        http.get(f"/scans/{scan['id']}/file"),
        http.post("/reconstructions", json={"scan_id": scan["id"]}),
    ):
        assert (answer.status_code, answer.json()["code"]) == (409, "not-ready")
        assert answer.json()["retryable"] is True
        assert answer.headers["retry-after"] == "1"


def test_reconstruction_of_a_scan_without_alines_is_refused(server, http, scan):
    scans = ScanRepository(server.database)
    for state in (ScanState.ARMING, ScanState.RUNNING, ScanState.STOPPING, ScanState.PARTIAL):
        scans.transition(scan["id"], state, why="test", summary={"points": 69, "stored": 0, "fired": 5})
    for file in (False, True):
        if file:
            server.data.scan_file(scan["id"]).write_bytes(b"not read here")
        answer = http.post("/reconstructions", json={"scan_id": scan["id"]})
        assert (answer.status_code, answer.json()["code"]) == (409, "conflict")
        assert "holds no A-lines" in answer.json()["detail"]


def test_a_volume_beyond_the_limit_is_refused_before_it_is_queued(server, http, scan):
    scans = ScanRepository(server.database)
    for state in (ScanState.ARMING, ScanState.RUNNING, ScanState.STOPPING, ScanState.PARTIAL):
        scans.transition(scan["id"], state, why="test", summary={"points": 69, "stored": 5, "fired": 5})
    server.data.scan_file(scan["id"]).write_bytes(b"not read here")
    answer = http.post("/reconstructions", json={"scan_id": scan["id"], "parameters": {"modes": 226}})
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["pointer"] == "#/parameters/modes"
    assert "at most 16777216 bytes" in answer.json()["detail"]


def test_a_reconstruction_is_queued_before_there_is_a_worker_and_can_be_cancelled(server, http, scan):
    scans = ScanRepository(server.database)
    for state in (ScanState.ARMING, ScanState.RUNNING, ScanState.STOPPING, ScanState.PARTIAL):
        scans.transition(scan["id"], state, why="test", summary={"points": 69, "stored": 5, "fired": 5})
    server.data.scan_file(scan["id"]).write_bytes(b"not read here")
    answer = http.post("/reconstructions", json={"scan_id": scan["id"], "parameters": {"modes": 32}})
    job = answer.json()
    assert (answer.status_code, job["state"], job["attempt"]) == (202, "queued", 0)
    assert answer.headers["location"] == job["links"]["self"]
    assert http.get(f"/jobs/{job['id']}/log").text == ""
    for link in ("volume", "mip_z"):
        answer = http.get(job["links"][link].removeprefix("/api/v1"))
        assert (answer.status_code, answer.json()["code"]) == (409, "not-ready")
    for _ in range(2):
        answer = http.put(f"/jobs/{job['id']}/desired-state", json={"state": "cancelled", "reason": "typo"})
        assert (answer.status_code, answer.json()["state"], answer.json()["reason"]) == (200, "cancelled", "typo")
    answer = http.get(job["links"]["mip_z"].removeprefix("/api/v1"))
    assert (answer.status_code, answer.json()["code"]) == (409, "conflict")
    assert job["id"] in [item["id"] for item in http.get("/reconstructions").json()["items"]]


def test_readiness_lists_missing_components(server):
    answer = httpx.get(f"{server.url}/readyz", timeout=250)
    checks = answer.json()["checks"]
    assert answer.status_code == 503
    assert checks["database"]
    assert checks["store"]
    assert not checks["acquisition"]
    assert not checks["worker-0"]
