"""Two API nodes, a scanner's node and a worker in four folders: whichever is asked, the answer is the service's."""

import hashlib
import io
import threading
import uuid
from contextlib import contextmanager
from pathlib import Path

import h5py
import httpx
import numpy as np
import pytest

from support.cluster import SECRET, Cluster, Node
from support.seaweed import SECRET as STORE_SECRET
from support.services import WAIT
from support.waiting import until

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]
KEY = "a-key-of-tests-with-every-scope"
PARAMETERS = {"modes": 24}


@pytest.fixture(scope="module")
def cluster(tmp_path_factory, postgres, seaweed):
    folder = tmp_path_factory.mktemp("cluster")
    scanners, settings = {"scanner-0": "simulated"}, {"api_key": KEY, "simulator_speed": 20.0}
    with Cluster(folder, postgres, seaweed, scanners, workers=1, followers=1, **settings) as cluster:
        yield cluster


@pytest.fixture
def first(cluster):
    return cluster.first


@pytest.fixture
def second(cluster):
    return cluster.second


@pytest.fixture(scope="module")
def scan(cluster):
    return cluster.first.make("/scans", plan_id=cluster.first.plan())


@pytest.fixture(scope="module")
def image(cluster, scan):
    return cluster.second.done("/reconstructions", scan_id=scan["id"], parameters=PARAMETERS)


def of_scan(node, scan, part, **how):
    return node.get(f"/scans/{scan['id']}/{part}", **how)


def test_stage_is_decided_at_any_node_and_made_once_though_the_scanner_node_is_killed(cluster, first, second):
    mask = first.make("/masks", arrangement="equi-steradian", aperture=0.01356, depth=0.0036, count=60)
    survey = {"points": 24, "decision": "ask", "least_signal_to_noise": 1000.0}
    plan = first.make("/plans", mask_id=mask["id"], samples=384, pulse_rate=200.0, survey=survey)
    here = f"/scans/{first.start_scan(plan['id'])['id']}"

    def is_asked():
        seen = second.get(here).json()
        return seen["state"] == "paused" and seen["stages"][1]["state"] == "proposed"

    until(is_asked)
    node = cluster.scanners["scanner-0"]
    node.kill()
    node.start()
    until(lambda: second.get(here).json()["state"] == "interrupted")
    first.http.put(f"{here}/desired-state", json={"state": "running"}).raise_for_status()
    until(is_asked)
    places = {"points_of_interest": [[2e-3, -1.5e-3, 2.5e-3]]}
    second.http.put(f"{here}/stages/2", json=places).raise_for_status()
    until(lambda: first.get(here).json()["state"] == "complete")
    seen = first.get(here).json()
    points = sum(stage["points"] for stage in seen["stages"])
    assert seen["summary"]["stored"] == seen["summary"]["points"] == points
    for each in (first, second):
        with h5py.File(io.BytesIO(each.get(f"{here}/file").content)) as file:
            assert file["mask"].attrs["id"] == seen["mask_id"] == seen["stages"][1]["mask_id"]
            assert (file["alines/status"][:] == 1).all()
            assert len(np.unique(file["alines/shot"][:24])) == 24


def test_a_scan_that_runs_is_seen_from_every_node_as_its_scanner_s_node_sees_it(cluster, first, second):
    plan = first.plan(1600, pulse_rate=1, averages=2)
    scan = first.start_scan(plan)
    until(lambda: second.get(f"/scans/{scan['id']}").json()["state"] == "running")
    until(lambda: second.http.get(f"/scans/{scan['id']}/coverage").json().get("stored", 0) > 3)
    since = of_scan(first, scan, "shots").json()["next"]
    before = of_scan(first, scan, "coverage").json()["stored"]
    until(lambda: of_scan(second, scan, "coverage").json()["stored"] > before + 2)
    news = of_scan(second, scan, "shots", params={"since": since}).json()
    assert 0 < sum(news["stored"]) < news["coverage"]["stored"], "only what is new, though another node is asked"
    newest = of_scan(second, scan, "alines/latest", headers={"Accept": "application/octet-stream"})
    row = int(newest.headers["X-Row"])
    one = of_scan(first, scan, "alines", params={"slice": str(row)}, headers={"Accept": "application/octet-stream"})
    assert one.content == newest.content != b""
    unchanged = of_scan(second, scan, "alines/latest", headers={"Accept": "application/octet-stream"})
    again = second.http.get(
        f"/scans/{scan['id']}/alines/latest",
        headers={"Accept": "application/octet-stream", "If-None-Match": unchanged.headers["ETag"]},
    )
    assert again.status_code in {200, 304}  # the scan goes on
    second.http.put(f"/scans/{scan['id']}/desired-state", json={"state": "stopped"}).raise_for_status()
    done = first.get(f"/scans/{scan['id']}", headers=WAIT).json()
    assert done["state"] in {"partial", "complete"}
    assert (done["scanner_id"], done["simulated"]) == ("scanner-0", True)
    assert not list((first.folder / "scans").iterdir()), "nothing of it was here"


def test_a_scan_that_is_over_is_the_same_file_from_every_node(cluster, scan, first, second):
    files = [of_scan(node, scan, "file").content for node in (first, second, cluster.scanners["scanner-0"])]
    assert files[0] == files[1] == files[2]
    part = of_scan(second, scan, "file", headers={"Range": "bytes=8-1007"})
    assert (part.status_code, part.content) == (206, files[0][8:1008])


def test_worker_result_is_identical_from_every_node(first, second, image):
    volumes = [node.get(f"/reconstructions/{image['id']}/volume").content for node in (first, second)]
    assert volumes[0] == volumes[1]
    assert np.load(io.BytesIO(volumes[0])).shape[:2] == (24, 24)
    assert first.get(f"/jobs/{image['id']}/log").content == second.get(f"/jobs/{image['id']}/log").content


def test_an_image_that_grows_with_its_scan_is_seen_from_every_node_and_ends_as_its_full_reconstruction(
    cluster, first, second, image
):
    scan = first.start_scan(first.plan(1600, pulse_rate=1, averages=2))
    body = {"scan_id": scan["id"], "follow": True, "interval": 0.3, "parameters": PARAMETERS}
    live = first.http.post("/reconstructions", json=body).json()
    here = f"/reconstructions/{live['id']}"
    for node in (second, first):
        until(lambda node=node: node.http.get(f"{here}/revision").is_success)
        assert node.http.get(f"{here}/mip").content.startswith(b"\x89PNG")
    early = second.get(f"{here}/revision").json()
    second.http.put(f"/scans/{scan['id']}/desired-state", json={"state": "stopped"}).raise_for_status()
    done = second.get(here, headers=WAIT).json()
    assert (done["state"], early["final"]) == ("succeeded", False)
    assert done["report"] is not None
    whole = second.done("/reconstructions", scan_id=scan["id"], parameters=PARAMETERS)
    assert first.get(f"{here}/volume").content == second.get(f"/reconstructions/{whole['id']}/volume").content
    until(lambda: not list((cluster.scanners["scanner-0"].folder / "jobs").iterdir()))


def test_a_file_that_was_sent_to_one_node_is_looked_into_by_another_and_imported(first, second, scan):
    sent = first.done("/jobs", kind="export", scan_id=scan["id"], format="ipasc")
    file = second.get(f"{sent['links']['self']}/files/{sent['files'][0]}").content
    upload = first.http.post("/uploads", content=file).json()
    assert upload["sha256"] == hashlib.sha256(file).hexdigest()
    look = second.http.post(f"/uploads/{upload['id']}/preview", json={})
    assert look.is_success, look.text
    taken = second.done("/jobs", kind="import", upload_id=upload["id"])
    assert look.json()["points"] == taken["result"]["points"]
    shown = first.get(f"/scans/{taken['result']['scan_id']}").json()
    assert (shown["state"], shown["scanner_id"]) == ("complete", None)
    assert of_scan(first, shown, "coverage").json()["stored"] == taken["result"]["stored"]


def test_a_key_of_idempotency_holds_on_all_nodes_also_for_requests_at_once(first, second):
    plan, key = first.plan(count=80), {"Idempotency-Key": uuid.uuid4().hex}  # a plan that no other scan has
    answers, begin = [], threading.Barrier(8)

    def ask(node):
        with httpx.Client(base_url=node.http.base_url, timeout=250) as client:
            begin.wait()
            answers.append(client.post("/scans", json={"plan_id": plan}, headers=key))

    threads = [threading.Thread(target=ask, args=(node,)) for node in (first, second) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {answer.status_code for answer in answers} == {201}
    assert len({answer.json()["id"] for answer in answers}) == 1
    assert sum("Idempotency-Replayed" not in answer.headers for answer in answers) == 1
    listed = second.get("/scans", params={"plan_id": plan}).json()["items"]
    assert len(listed) == 1


def test_a_session_opened_on_one_node_holds_and_ends_on_the_other(first, second):
    signed_in = httpx.post(f"{first.url}/api/v1/session", headers={"Authorization": f"Bearer {KEY}"}, timeout=60)
    cookie = {"Cookie": f"steradian_session={signed_in.cookies['steradian_session']}"}
    seen = httpx.get(f"{second.url}/api/v1/session", headers=cookie, timeout=60).json()
    assert (seen["principal"], seen["csrf_token"]) == ("settings", signed_in.json()["csrf_token"])
    may = cookie | {"X-CSRF-Token": seen["csrf_token"], "Origin": second.url}
    mask = {"arrangement": "grid", "aperture": 0.01, "count": 3, "interval": 1e-3}
    assert httpx.post(f"{second.url}/api/v1/masks", headers=may, json=mask, timeout=60).status_code in {200, 201}
    assert httpx.delete(f"{second.url}/api/v1/session", headers=may, timeout=60).status_code == 204
    assert httpx.get(f"{first.url}/api/v1/session", headers=cookie, timeout=60).json()["csrf_token"] is None


def test_event_stream_of_one_node_is_resumed_on_another(first, second):
    about = {"kind": "scan", "progress": "false"}
    plan = first.plan()
    with stream(second, about) as lines:  # before the scan, which may end before a slow machine opens a stream
        place = next(line for line in lines if line.startswith("id: "))[4:]
    scan = first.start_scan(plan)
    first.get(f"/scans/{scan['id']}", headers=WAIT)
    with stream(first, about | {"last_event_id": place}) as lines:
        assert next(line for line in lines if scan["id"] in line and '"complete"' in line)


@contextmanager
def stream(node, about):
    """The lines of an event stream while a block lasts."""
    key = {"Authorization": f"Bearer {KEY}"}
    with httpx.stream("GET", f"{node.url}/api/v1/events", params=about, headers=key, timeout=250) as answer:
        assert answer.status_code == 200
        yield answer.iter_lines()


def test_a_lease_taken_on_one_node_binds_the_other(first, second):
    lease = first.http.put("/scanners/scanner-0/lease", json={"holder": "Ada"}).json()["lease"]
    refused = second.http.put("/scanners/scanner-0/lease", json={"holder": "Ben"})
    assert (refused.status_code, refused.json()["code"]) == (409, "lease-held")
    given = second.http.delete("/scanners/scanner-0/lease", headers={"Scanner-Lease": str(lease["fence"])})
    assert given.status_code == 204
    assert first.get("/scanners/scanner-0").json()["lease"] is None


def test_request_with_wrong_node_secret_returns_401(cluster, first):
    asked = {"Steradian-Principal": '{"name": "Eve", "scopes": ["admin"], "key_id": null}'}
    for node in cluster.nodes:
        for secret in ("", "x" * 40, SECRET[:-1]):
            answer = httpx.get(f"{node.url}/api/v1/scans", headers=asked | {"Steradian-Node": secret}, timeout=60)
            assert answer.status_code == 401


def test_a_second_node_of_a_scanner_is_refused(cluster, tmp_path):
    other = Node(tmp_path / "other", "acquisition", scanner_id="scanner-0", **cluster.shared)
    with pytest.raises(AssertionError, match="did not start"):
        other.start()
    code = other.process.wait(250)
    other.close()
    assert code == 4, other.log.read_text()


def test_a_node_s_folder_holds_nothing_that_another_one_needs(cluster, image, first):
    for node in (cluster.first, cluster.second):
        assert not list((node.folder / "jobs").iterdir())
        assert not list((node.folder / "scans").iterdir())
        assert not list((node.folder / "uploads").iterdir())
    assert SECRET not in cluster.said()
    for process in ("acquisition", "scanner-0-0"):
        pid = cluster.scanners["scanner-0"].pid_of(process)
        assert SECRET.encode() not in Path(f"/proc/{pid}/environ").read_bytes(), "only who answers requests needs it"
    assert STORE_SECRET not in cluster.said()
