"""What a job requires of a worker: checked when it is asked for, shown while it waits, counted for those who scale."""

import re
from datetime import timedelta

import httpx
import pytest

from steradian.jobs.queue.matching import Capabilities, WorkerRegistration
from steradian.storage.db.timestamps_and_ids import utc_now

from .conftest import api_of, make_scan

GIB = 2**30


@pytest.fixture(scope="module")
def server(database, tmp_path_factory):
    """A service without workers, whose notices the tests write."""
    server = api_of(tmp_path_factory.mktemp("requirements"), **database()).wait()
    yield server
    server.close()


@pytest.fixture(scope="module")
def http(server):
    with httpx.Client(base_url=f"{server.url}/api/v1", timeout=250) as client:
        yield client


@pytest.fixture
def note(server, http, scan_with_alines):
    """Notes what a worker has, ``ago`` seconds ago; the scan's own reconstruction was asked for before."""
    for job in http.get("/jobs", params={"state": "queued"}).json()["items"]:
        http.put(f"/jobs/{job['id']}/desired-state", json={"state": "cancelled"})

    def write(name, memory, cores, gpu=None, ago=0):
        clock = utc_now if not ago else lambda: utc_now() - timedelta(seconds=ago)
        WorkerRegistration(server.database, name, Capabilities(memory, cores, gpu), clock).publish()

    yield write
    for name in ("near-0", "far-0"):
        write(name, 1, 1, ago=10**6)


@pytest.fixture
def ask(http, scan_with_alines):
    return lambda **body: http.post("/reconstructions", json={"scan_id": scan_with_alines["scan"]["id"], **body})


def figure(server, name):
    return float(re.search(rf"^{name} (\S+)$", httpx.get(f"{server.url}/metrics", timeout=250).text, re.M)[1])


@pytest.mark.parametrize(
    ("body", "pointer"),
    [
        ({"parameters": {"modes": 32, "device": "gpu"}}, "#/parameters/device"),
        ({"parameters": {"modes": 32}, "requires": {"memory": 2 * GIB}}, "#/requires/memory"),
        ({"parameters": {"modes": 32}, "requires": {"cores": 3}}, "#/requires/cores"),
    ],
)
def test_job_with_unmet_requirements_returns_422_with_worker_capabilities(http, ask, note, body, pointer):
    made = ask(**body)
    assert made.status_code == 202, made.text
    note("near-0", GIB, 2)
    refused = ask(**body)
    assert refused.status_code == 422
    problem = refused.json()
    assert problem["errors"][0]["pointer"] == pointer, problem
    assert "1073741824 bytes of memory, 2 cores, no GPU" in problem["detail"]
    vary = {"modes": [16, 32]}
    batch = {key: value for key, value in body.items() if key == "requires"}
    if batch:
        scan = http.get("/scans").json()["items"][0]["id"]
        before = len(http.get("/batches").json()["items"])
        assert http.post("/batches", json={"scan_id": scan, "vary": vary, **batch}).status_code == 422
        assert len(http.get("/batches").json()["items"]) == before


def test_job_shows_requirements_and_awaited_worker(server, http, ask, note):
    note("near-0", GIB, 2)
    note("far-0", 8 * GIB, 16, "a card")
    job = ask(parameters={"modes": 32, "device": "gpu"}, requires={"memory": 2 * GIB, "cores": 4}).json()
    wanted = {"memory": 2 * GIB, "cores": 4, "gpu": True}
    assert job["requires"] == wanted
    assert http.get(f"/jobs/{job['id']}").json()["requires"] == wanted
    assert http.get(f"/jobs/{job['id']}").json()["queue"]["awaited"] is None
    assert figure(server, "steradian_jobs_waiting_unmet") == 0

    note("far-0", 8 * GIB, 16, "a card", ago=300)
    said = http.get(f"/reconstructions/{job['id']}").json()["queue"]["awaited"]
    assert said == (
        "a worker with 2147483648 bytes of memory and 4 cores and a GPU;"
        " present: 1073741824 bytes of memory, 2 cores, no GPU"
    )
    assert figure(server, "steradian_jobs_waiting_unmet") == 1
    shown = httpx.get(f"{server.url}/metrics", timeout=250).text
    assert 'steradian_worker{cores="2",gpu="",memory="1073741824",worker="near-0"} 1.0' in shown
    assert 'worker="far-0"' not in shown
    http.put(f"/jobs/{job['id']}/desired-state", json={"state": "cancelled"})


def test_a_volume_requires_memory_for_its_values_where_its_size_is_known(ask):
    whole = ask(parameters={"modes": 32}).json()
    assert whole["requires"] == {"memory": 4 * 32 * 32 * 256, "cores": 0, "gpu": False}
    fine = ask(parameters={"modes": 32, "upsampling": 2}).json()
    assert fine["requires"]["memory"] == 4 * 64 * 64 * 256, "finer across, not in depth"
    cut = ask(parameters={"modes": 32, "depth_range": [0.0, 1e-3]}).json()
    assert cut["requires"]["memory"] == 0


def test_an_image_of_a_line_requires_memory_for_two_axes(http, ask):
    mask = http.post("/masks", json={"arrangement": "equiangular", "aperture": 1e-2, "depth": 3e-3, "count": 20})
    plan = http.post("/plans", json={"mask_id": mask.raise_for_status().json()["id"], "samples": 256})
    scan = make_scan(http, plan.raise_for_status().json()["id"])
    image = ask(scan_id=scan.raise_for_status().json()["id"], parameters={"modes": 32}, follow=True)
    assert image.raise_for_status().json()["requires"]["memory"] == 4 * 32 * 256


@pytest.mark.long
def test_job_with_unmet_requirements_is_accepted_with_await_workers(database, tmp_path):
    server = api_of(tmp_path, await_workers=True, **database()).wait()
    try:
        WorkerRegistration(server.database, "near-0", Capabilities(GIB, 2)).publish()
        with httpx.Client(base_url=f"{server.url}/api/v1", timeout=250) as client:
            answer = _empty_import(client)
            assert answer.status_code == 202, answer.text
            job = client.get(f"/jobs/{answer.json()['id']}").json()
            assert job["queue"]["awaited"].startswith("a worker with 64 cores; present: ")
    finally:
        server.close()


def _empty_import(client):
    """Ask for an import that needs 64 cores."""
    upload = client.post("/uploads", content=b"x").json()
    return client.post("/jobs", json={"kind": "import", "upload_id": upload["id"], "requires": {"cores": 64}})
