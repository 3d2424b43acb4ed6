"""One identifier, looked for in all that the processes wrote, tells what a request caused."""

import json
import os
import signal
import uuid

import pytest

from support.processes import children_of, runs
from support.services import Service
from support.waiting import until

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]
PARAMETERS = {"modes": 16}


class Traced(Service):
    """A service whose log is for machines, and what stands in it."""

    def ask(self, name, path, **body):
        """Ask for something under an identifier and return it at once."""
        headers = {"X-Request-ID": name, "Idempotency-Key": uuid.uuid4().hex}
        answer = self.http.post(path, json=body, headers=headers)
        assert answer.status_code in (201, 202), answer.text
        return answer.json()

    def over(self, made, *states):
        """Wait until something that was asked for has come to one of some states; returns it then."""
        until(lambda: self.get(made["links"]["self"]).json()["state"] in states)
        return self.get(made["links"]["self"]).json()

    def story(self, name):
        """Tell what all processes wrote under an identifier."""
        lines = self.log.read_text().split("\n")[:-1]  # the last may be half there
        entries = [json.loads(line) for line in lines if line.startswith("{")]
        return [entry for entry in entries if entry.get("request_id") == name]

    def until_told(self, name, process, *words):
        """Wait until a process has written a line with these words under an identifier; returns the line."""

        def found():
            told = (entry for entry in self.story(name) if entry["process"] == process)
            return next((entry for entry in told if all(word in entry["message"] for word in words)), None)

        return until(found, tell=lambda: f"{process}: {words} in {self.story(name)}")

    def attempts(self, job):
        return self.get(f"/jobs/{job['id']}/attempts").json()["items"]


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    service = Traced(tmp_path_factory.mktemp("traced"), log_format="json", simulator_speed=20.0).start()
    yield service
    service.close()


@pytest.fixture(scope="module")
def scan(service):
    made = service.ask("scan-1", "/scans", plan_id=service.plan())
    return service.over(made, "complete")


@pytest.fixture(scope="module")
def image(service, scan):
    made = service.ask("image-1", "/reconstructions", scan_id=scan["id"], parameters=PARAMETERS)
    return service.over(made, "succeeded")


def test_a_scan_is_followed_from_the_request_to_its_last_state(service, scan):
    assert scan["request_id"] == "scan-1"
    made = service.until_told("scan-1", "api", "POST /api/v1/scans 201")
    assert made["location"] == f"/api/v1/scans/{scan['id']}"
    for state in ("arming", "running", "complete"):
        service.until_told("scan-1", "acquisition", f"scan {scan['id']} is {state}")
    session = service.until_told("scan-1", "acquisition", "session", "with the scanner begins")
    assert session["logger"].startswith("fabry_perot."), "the device knows no more of it than this number"


def test_a_reconstruction_is_followed_into_the_worker_and_the_process_that_works(service, image):
    assert image["request_id"] == service.get(f"/jobs/{image['id']}").json()["request_id"] == "image-1"
    made = service.until_told("image-1", "api", "POST /api/v1/reconstructions 202")
    assert made["location"] == f"/api/v1/reconstructions/{image['id']}"
    for state in ("running", "succeeded"):
        service.until_told("image-1", "worker-0", f"job {image['id']} is {state}")
    (start,) = service.get(f"/jobs/{image['id']}/log").text.splitlines()
    assert json.loads(start)["message"] == f"start 1 of reconstruction {image['id']}"
    assert json.loads(start)["request_id"] == "image-1"


def test_every_job_of_a_batch_bears_its_identifier_and_no_other_story_gets_a_line_of_it(service, scan, image):
    vary = {"sound_speed": [1480.0, 1500.0]}
    made = service.ask("sweep-1", "/batches", scan_id=scan["id"], vary=vary, parameters=PARAMETERS)
    jobs = [job["id"] for job in service.over(made, "succeeded")["jobs"]]
    for job in jobs:
        assert service.get(f"/jobs/{job}").json()["request_id"] == "sweep-1"
        service.until_told("sweep-1", "worker-0", f"job {job} is succeeded")
        assert "image-1" not in service.get(f"/jobs/{job}/log").text, "though the same process did it"
    lines = [entry["message"] for entry in service.story("image-1")]
    assert not [line for line in lines if any(job in line for job in jobs)]
    assert not [entry for entry in service.story("sweep-1") if image["id"] in entry["message"]]


def test_an_import_passes_its_identifier_on_to_the_scan_it_makes(service, scan):
    sent = service.done("/jobs", kind="export", scan_id=scan["id"], format="ipasc")
    file = service.get(f"{sent['links']['self']}/files/{sent['files'][0]}").content
    upload = service.http.post("/uploads", content=file).json()
    taken = service.over(service.ask("import-1", "/jobs", kind="import", upload_id=upload["id"]), "succeeded")
    assert service.get(taken["links"]["scan"]).json()["request_id"] == "import-1"


def test_a_failure_bears_the_identifier_in_the_workers_log_and_the_jobs(service):
    upload = service.http.post("/uploads", content=b"%PDF-1.7 no recording").json()
    job = service.over(service.ask("bad-1", "/jobs", kind="import", upload_id=upload["id"]), "failed")
    line = service.until_told("bad-1", "worker-0", job["id"], job["error"]["detail"])
    assert line["level"] == "WARNING"
    said = service.get(f"/jobs/{job['id']}/log").text.splitlines()
    assert all("bad-1" in line for line in said), said


def test_lost_worker_and_silent_scanner_are_logged_under_request_id(service, image):
    """A job that is started again keeps its identifier; the driver's own lines bear that of the scan."""
    slow = service.ask("slow-1", "/scans", plan_id=service.plan(pulse_rate=1, averages=20))
    live = service.ask("live-1", "/reconstructions", scan_id=slow["id"], follow=True, parameters=PARAMETERS)
    service.over(slow, "running")
    service.over(live, "running")
    until(lambda: '"live-1"' in service.get(f"/jobs/{live['id']}/log").text)
    os.kill(service.pid_of("worker-0"), signal.SIGKILL)
    until(lambda: len(service.attempts(live)) == 2)
    service.until_told("live-1", "worker-0", f"job {live['id']} is queued", "its worker died")

    found = [pid for pid in children_of(service.pid_of("acquisition")) if runs(pid, "simulator")]
    assert len(found) == 1
    os.kill(found[0], signal.SIGSTOP)
    try:
        silent = service.until_told("slow-1", "acquisition", "the scanner is silent")
    finally:
        os.kill(found[0], signal.SIGCONT)
    assert silent["logger"].startswith("fabry_perot.")

    wish = {"state": "stopped", "reason": "seen enough"}
    answer = service.http.put(f"/scans/{slow['id']}/desired-state", json=wish, headers={"X-Request-ID": "stop-1"})
    assert answer.json()["request_id"] == "slow-1", "whoever ends it, this is who began it"
    service.until_told("stop-1", "api", f"scan {slow['id']} is wished stopped: seen enough")
    service.over(slow, "partial", "aborted", "complete")
    done = service.over(live, "succeeded", "failed")
    assert done["request_id"] == "live-1"
    starts = [line for line in service.get(f"/jobs/{live['id']}/log").text.splitlines() if "start " in line]
    assert [json.loads(line)["request_id"] for line in starts] == ["live-1", "live-1"]


def test_emergency_stop_is_logged_under_request_ids_of_press_and_scan(service):
    slow = service.ask("slow-2", "/scans", plan_id=service.plan(pulse_rate=1, averages=20))
    service.over(slow, "running")
    stop = "/scanners/scanner-0/emergency-stop"
    pressed = service.http.post(stop, json={"reason": "smoke"}, headers={"X-Request-ID": "press-2"})
    assert pressed.is_success, pressed.text
    service.until_told("press-2", "api", f"POST /api/v1{stop}")
    service.until_told("slow-2", "acquisition", "emergency stop: smoke, pressed by", "laser off")
    service.over(slow, "aborted", "partial")
    service.http.delete(stop).raise_for_status()
