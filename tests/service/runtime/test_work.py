"""Every kind of work through a real service over HTTP, and how work ends when somebody wants it to."""

import json
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from steradian.core.settings import Settings
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.jobs.queue.queue_client import JobQueue
from steradian.jobs.reconstruction_request import ReconstructionRequest
from steradian.jobs.requests import to_job_request
from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.runtime.supervisor import running_worker
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from steradian.storage.db.database import Database, metadata_url
from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import ReconstructionState, ScanState
from support import warmed
from support.alines import Aline
from support.processes import children_of, resident, runs
from support.services import WAIT, Service
from support.waiting import until

pytestmark = [pytest.mark.long, pytest.mark.timeout(300)]  # the first reconstruction on a machine compiles its kernels
PARAMETERS = {"modes": 24}


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    service = Service(tmp_path_factory.mktemp("service"), simulator_speed=20.0).start()
    yield service
    service.close()


@pytest.fixture(scope="module")
def scan(service):
    return service.make("/scans", plan_id=service.plan())


@pytest.fixture(scope="module")
def image(service, scan):
    return service.done("/reconstructions", scan_id=scan["id"], parameters=PARAMETERS)


def test_reconstruction_result_states_effective_parameters(image):
    assert image["parameters"]["sound_speed"] == image["report"]["sound_speed_m_s"] == 1500.0
    assert image["parameters"]["modes"] == PARAMETERS["modes"]


def test_a_scan_is_followed_while_it_runs_and_ends_as_its_full_reconstruction(service, scan, image):
    service.done("/reconstructions", scan_id=scan["id"], follow=True, parameters=PARAMETERS)  # its kernels are there
    slow = service.start_scan(service.plan(pulse_rate=1, averages=2))
    job = service.http.post(
        "/reconstructions", json={"scan_id": slow["id"], "follow": True, "interval": 0.3, "parameters": PARAMETERS}
    ).json()
    seen, deadline = [], time.monotonic() + 250
    while time.monotonic() < deadline:
        answer = service.http.get(f"/reconstructions/{job['id']}/revision")
        if answer.status_code == 200:
            seen.append(answer.json())
            if not seen[-1]["final"]:
                assert service.get(f"/reconstructions/{job['id']}/mip").content.startswith(b"\x89PNG")
            if seen[-1]["final"]:
                break
        time.sleep(0.1)
    numbers = [revision["number"] for revision in seen]
    assert numbers == sorted(numbers)
    early = [revision for revision in seen if not revision["final"]]
    assert early, "there are images before the scan is over"
    assert early[0]["coverage"]["points"] < 1
    done = service.get(f"/reconstructions/{job['id']}", headers=WAIT).json()
    assert (done["state"], done["kind"]) == ("succeeded", "live")
    whole = service.done("/reconstructions", scan_id=slow["id"], parameters=PARAMETERS)
    figures = service.done(f"/reconstructions/{done['id']}/quality", reference_id=whole["id"])["result"]["figures"]
    assert figures["volume_error"] < 1e-4


def test_a_view_of_a_scan_that_waits_leaves_the_worker_to_others(service, scan):
    slow = service.start_scan(service.plan(pulse_rate=1, averages=64))
    waiting = service.start_scan(service.plan())
    body = {"scan_id": waiting["id"], "follow": True, "parameters": PARAMETERS}
    view = service.http.post("/reconstructions", json=body).json()
    for _ in range(3):
        service.done("/reconstructions", scan_id=scan["id"], parameters=PARAMETERS)
    seen = service.get(f"/reconstructions/{view['id']}").json(), service.get(f"/scans/{waiting['id']}").json()
    service.http.put(f"/scans/{slow['id']}/desired-state", json={"state": "aborted"}).raise_for_status()
    assert [one["state"] for one in seen] == ["queued", "queued"]
    done = service.get(f"/reconstructions/{view['id']}", headers=WAIT).json()
    assert (done["state"], done["attempt"]) == ("succeeded", 1)


def test_a_scan_travels_to_another_program_and_back(service, scan, image):
    sent = service.done("/jobs", kind="export", scan_id=scan["id"], format="ipasc")
    file = service.get(f"{sent['links']['self']}/files/{sent['files'][0]}").content
    upload = service.http.post("/uploads", content=file).json()
    taken = service.done("/jobs", kind="import", upload_id=upload["id"], labels={"from": "ipasc"})
    scan_id = taken["result"]["scan_id"]
    shown = service.get(taken["links"]["scan"]).json()
    assert (shown["id"], shown["state"], shown["labels"]) == (scan_id, "complete", {"from": "ipasc"})
    assert service.http.get(f"/uploads/{upload['id']}").status_code == 404
    again = service.done("/reconstructions", scan_id=scan_id, parameters=PARAMETERS)
    figures = service.done("/jobs", kind="quality", reconstruction_id=again["id"], reference_id=image["id"])["result"]
    assert figures["figures"]["volume_correlation"] > 0.999
    listed = service.get(f"/reconstructions/{again['id']}/quality").json()["items"]
    assert listed[0]["figures"] == figures["figures"]


def test_a_file_that_is_no_recording_fails_with_the_reason_and_makes_no_scan(service, scan):
    before = service.get("/scans").json()
    upload = service.http.post("/uploads", content=b"%PDF-1.7 no recording").json()
    job = service.make("/jobs", kind="import", upload_id=upload["id"])
    while job["state"] in {"queued", "running"}:
        job = service.get(job["links"]["self"], headers=WAIT).json()
    assert (job["state"], job["error"]["code"], job["attempt"]) == ("failed", "damaged-file", 1)
    assert service.get("/scans").json() == before


def test_export_job_of_volume_writes_requested_format(service, image):
    job = service.done("/jobs", kind="export", reconstruction_id=image["id"], format="nrrd")
    file = service.get(f"{job['links']['self']}/files/{job['files'][0]}")
    assert file.content.startswith(b"NRRD")
    assert len(file.content) > 24 * 24 * 256


def test_batch_over_masks_reports_quality_of_each_mask(service, scan):
    grid = {"arrangement": "grid", "aperture": 13.56e-3, "interval": 1.2e-3}
    masks = [service.make("/masks", **grid, count=count)["id"] for count in (3, 7)]
    made = service.make("/batches", scan_id=scan["id"], vary={"mask_id": masks}, parameters=PARAMETERS)
    until(lambda: service.get(f"/batches/{made['id']}").json()["state"] not in {"queued", "running"})
    batch = service.get(f"/batches/{made['id']}").json()
    assert batch["state"] == "succeeded"
    quality = [job["figures"]["what_if"]["quality"]["volume_correlation"] for job in batch["jobs"]]
    assert quality[0] < quality[1] < 1, "more points see more"
    values = np.frombuffer(
        service.get(
            f"/reconstructions/{batch['jobs'][0]['id']}/volume", headers={"Accept": "application/octet-stream"}
        ).content,
        np.float32,
    )
    assert values.size == 24 * 24 * 256


def test_the_speed_of_sound_is_looked_for(service, scan):
    job = service.done(
        "/jobs", kind="sound-speed", scan_id=scan["id"], first=1400, last=1600, steps=5, parameters=PARAMETERS
    )
    assert 1400 <= job["result"]["best"] <= 1600
    picture = service.get(f"{job['links']['self']}/files/sound-speed.png").content
    assert picture.startswith(b"\x89PNG")


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc").exists(), reason="memory of processes is read from /proc")
def test_cancelling_a_running_reconstruction_frees_its_memory_and_core_within_a_second(tmp_path, capsys, slowed):
    settings = Settings.create(data=tmp_path)
    queue = JobQueue(settings)
    mask = equi_steradian_mask(13.56e-3, 3.6e-3, 200)
    plan = ScanPlan.create(mask=mask, samples=1024)
    path = tmp_path / "scans" / "s1.h5"
    create_scan_file(path, plan, scan_id="s1")
    noise = np.random.default_rng(0).integers(-1000, 1000, (mask.count, 1024)).astype(np.int16)
    with ScanFileWriter(path) as store:
        store.append(Aline(point, row, point + 1) for point, row in enumerate(noise))
    large, small = (ReconstructionRequest.create(scan_id="s1", parameters={"modes": modes}) for modes in (452, 16))
    try:
        with running_worker(settings):
            queue.submit(to_job_request("warm", small))
            assert queue.wait("warm", timeout=250).state is ReconstructionState.SUCCEEDED
            queue.submit(to_job_request("large", large))
            until(lambda: queue.status("large").state is ReconstructionState.RUNNING)
            worker = json.loads((tmp_path / "run" / "worker-0.json").read_text())["pid"]
            child = until(
                lambda: next((pid for pid in children_of(worker) if runs(pid, "steradian.jobs.worker.child")), None)
            )
            held = until(lambda: (found := resident(child)) > 600e6 and found)
            begun = time.monotonic()
            queue.cancel("large", "ada", "no longer wanted")
            until(lambda: resident(child) == 0)
            took, slow = time.monotonic() - begun, slowed()
            assert queue.wait("large", timeout=250).state is ReconstructionState.CANCELLED
            left = {file.name for file in (tmp_path / "jobs" / "large").iterdir()}
            assert "volume.h5" not in left
            queue.submit(to_job_request("after", small))
            assert queue.wait("after", timeout=250).state is ReconstructionState.SUCCEEDED
    finally:
        queue.close()
    with capsys.disabled():
        print(f"\n  {held / 1e6:.0f} MB and the process of a cancelled reconstruction were free after {took:.2f} s")
    assert took < 1.0 * slow


@pytest.mark.long
def test_a_service_that_is_asked_to_end_puts_jobs_back_and_makes_the_scan_safe(tmp_path, capsys, slowed):
    service = Service(tmp_path, simulator_speed=20.0).start()
    done = service.make("/scans", plan_id=service.plan())
    slow = service.start_scan(service.plan(1600, pulse_rate=1, averages=2))
    until(lambda: service.get(f"/scans/{slow['id']}").json()["state"] == "running")
    until(lambda: service.get(f"/scans/{slow['id']}/coverage").json()["stored"] > 2)
    large = service.http.post("/reconstructions", json={"scan_id": done["id"], "parameters": {"modes": 1024}}).json()
    until(lambda: service.get(f"/reconstructions/{large['id']}").json()["state"] == "running")
    begun = time.monotonic()
    assert service.end() == 0
    took, stretch = time.monotonic() - begun, slowed()
    database = Database(metadata_url(service.settings))
    job, scan = JobLedger(database).get(large["id"]), ScanRepository(database).get(slow["id"])
    database.close()
    with capsys.disabled():
        print(f"\n  SIGTERM with a running job and scan: all ended after {took:.1f} s")
    assert took < 10 * stretch
    assert (job.state, job.attempt) == (ReconstructionState.QUEUED, 0)
    assert job.attempts[0]["outcome"] == "put back"
    assert scan.state is ScanState.INTERRUPTED
    with ScanFileWriter(tmp_path / "scans" / f"{slow['id']}.h5") as store:
        assert store.stored > 2, "what was acknowledged is there"


@pytest.mark.long
def test_reconstructions_run_on_the_service_and_on_a_worker_started_elsewhere(tmp_path, postgres, capsys):
    """The two commands on one PostgreSQL: `steradian worker` shares the work of `steradian serve`."""
    begun = time.monotonic()
    service = Service(tmp_path, database_url=postgres.database(), simulator_speed=20.0).start()
    assert service.get("/").status_code == 200
    with capsys.disabled():
        print(f"\n  steradian serve on PostgreSQL answers after {time.monotonic() - begun:.1f} s")
    command = [sys.executable, "-m", "steradian", "worker", "--name", "elsewhere"]
    with (tmp_path / "worker.log").open("wb") as log:
        worker = warmed.start(command, env=service.settings.environment(), stdout=log, stderr=log)
        try:
            scan = service.make("/scans", plan_id=service.plan())
            who, deadline = set(), time.monotonic() + 100
            while who != {"worker-0", "elsewhere-0"} and time.monotonic() < deadline:
                body = {"scan_id": scan["id"], "parameters": PARAMETERS}
                jobs = [service.http.post("/reconstructions", json=body).json()["id"] for _ in range(4)]
                for job in jobs:
                    assert service.get(f"/reconstructions/{job}", headers=WAIT).json()["state"] == "succeeded"
                starts = [service.get(f"/jobs/{job}/attempts").json()["items"] for job in jobs]
                assert {len(items) for items in starts} == {1}
                who |= {items[0]["worker"] for items in starts}
            assert who == {"worker-0", "elsewhere-0"}
        finally:
            worker.terminate()
            assert worker.wait(250) == 0
            service.close()
