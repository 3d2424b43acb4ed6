"""Where a job stands in the queue and when it will be over, as far as past jobs tell."""

import re
from datetime import UTC, datetime, timedelta

import httpx
import pytest
from sqlalchemy import select

from steradian.jobs.job import Succeeded
from steradian.jobs.queue.estimates import forecast
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.storage.db.tables import JobRow

from .conftest import api_of, make_scan

BEGIN = datetime(2026, 1, 1, tzinfo=UTC)


class Clock:
    now = BEGIN

    def __call__(self):
        return self.now

    def advance(self, seconds):
        self.now += timedelta(seconds=seconds)


@pytest.fixture(scope="module")
def server(database, tmp_path_factory):
    """A service with two workers' worth of settings, whose jobs the tests start and end themselves."""
    server = api_of(tmp_path_factory.mktemp("queue"), workers=2, **database()).wait()
    yield server
    server.close()


@pytest.fixture(scope="module")
def http(server):
    with httpx.Client(base_url=f"{server.url}/api/v1", timeout=250) as client:
        yield client


@pytest.fixture
def clock():
    """Begins in a future that has not come, so that nothing is overdue."""
    clock = Clock()
    clock.now = datetime.now(UTC) + timedelta(hours=1)
    return clock


@pytest.fixture
def ledger(server, clock):
    return JobLedger(server.database, clock)


@pytest.fixture
def jobs(http, scan_with_alines):
    """Queues a job; nothing of earlier tests waits or runs."""
    for job in http.get("/jobs", params={"state": ["queued", "running"]}).json()["items"]:
        http.put(f"/jobs/{job['id']}/desired-state", json={"state": "cancelled"})
    asked = {"kind": "export", "scan_id": scan_with_alines["scan"]["id"], "format": "ipasc"}

    def queue():
        answer = http.post("/jobs", json=asked)
        assert answer.status_code == 202, answer.text
        return answer.json()["id"]

    return queue


def place(http, job_id):
    return http.get(f"/jobs/{job_id}").json()["queue"]


def figure(server, name):
    return float(re.search(rf"^{name} (\S+)$", httpx.get(f"{server.url}/metrics", timeout=250).text, re.M)[1])


def test_the_position_is_by_priority_and_then_by_age(http, jobs):
    first, second, urgent, third = jobs(), jobs(), jobs(), jobs()
    http.patch(f"/jobs/{urgent}", json={"priority": 1})
    assert [place(http, job)["position"] for job in (urgent, first, second, third)] == [1, 2, 3, 4]
    seen = http.get(f"/jobs/{third}").headers["etag"]
    moved = http.patch(f"/jobs/{third}", json={"priority": 0})
    assert moved.json()["queue"]["position"] == 1
    assert moved.headers["etag"] == http.get(f"/jobs/{third}").headers["etag"] != seen
    assert place(http, second)["position"] == 4
    http.put(f"/jobs/{first}/desired-state", json={"state": "cancelled"})
    assert place(http, second)["position"] == 3, "what is not told to have changed shows the change all the same"
    assert place(http, first) is None
    listed = {one["id"]: one for one in http.get("/jobs").json()["items"]}
    assert listed[second]["queue"] is None, "a list does not work it out"


def test_queue_expected_end_is_computed_from_past_job_durations(server, http, jobs, ledger, clock):
    """Two workers, jobs of 10.5 s each (the median): a job begins when a worker has done its one or those before it."""
    for seconds in (9, 10, 11, 50):
        job = jobs()
        ledger.start_attempt(job, "w")
        clock.advance(seconds)
        ledger.finish_attempt(job, 1, Succeeded({"bytes": 1}), "w")
    begun = clock.now
    running = [jobs(), jobs()]
    third, fourth, fifth = jobs(), jobs(), jobs()
    assert place(http, third)["expected_end"] is None, "nobody works"
    for job in running:
        ledger.start_attempt(job, "w")
        clock.advance(4)
    for job, seconds in zip(running, (10.5, 14.5), strict=True):
        assert datetime.fromisoformat(place(http, job)["expected_end"]) == begun + timedelta(seconds=seconds)
    with server.database.read() as session:
        for number, (job, seconds) in enumerate(((third, 21), (fourth, 25), (fifth, 31.5))):
            estimate = forecast(session, job, 2, clock.now)
            assert estimate.position == number + 1
            assert estimate.expected_end == begun + timedelta(seconds=seconds)
            assert forecast(session, job, 2, clock.now + timedelta(seconds=1)) == estimate, "an ETag that holds"
            assert forecast(session, job, 2, clock.now + timedelta(minutes=1)).expected_end is None, "overdue"
    assert [place(http, job)["position"] for job in (*running, third)] == [None, None, 1]
    assert figure(server, "steradian_jobs_waiting_work_seconds") == 3 * 10.5
    assert 0 < figure(server, "steradian_jobs_waiting_oldest_seconds") < 600


def test_a_job_may_end_while_the_end_is_worked_out(server, jobs, ledger):
    """On PostgreSQL a job that has been read as running is among those that are done a moment later."""
    running, waiting = jobs(), jobs()
    ledger.start_attempt(running, "w")
    with server.database.read() as session:
        read = session.scalars(select(JobRow).where(JobRow.id == running)).all()
        ledger.finish_attempt(running, read[0].fence, Succeeded({"bytes": 1}), "w")
        assert forecast(session, waiting, 2, datetime.now(UTC)).position == 1


def test_queue_overdue_jobs_have_no_expected_end(http, jobs, ledger, clock):
    clock.now = BEGIN  # long ago
    for _ in range(3):
        job = jobs()
        ledger.start_attempt(job, "w")
        clock.advance(10)
        ledger.finish_attempt(job, 1, Succeeded({"bytes": 1}), "w")
    late = jobs()
    ledger.start_attempt(late, "w")
    assert place(http, late) == {"position": None, "expected_end": None, "awaited": None}


def test_queue_job_awaiting_its_scan_has_no_position(http, jobs):
    before = jobs()
    plan = http.get("/plans").json()["items"][0]["id"]
    scan = make_scan(http, plan).json()["id"]
    live = http.post("/reconstructions", json={"scan_id": scan, "follow": True, "parameters": {"modes": 8}}).json()
    assert place(http, live["id"]) == {"position": None, "expected_end": None, "awaited": None}
    after = jobs()
    assert [place(http, job)["position"] for job in (before, after)] == [1, 2]
    assert http.get(f"/reconstructions/{live['id']}").json()["queue"] == {
        "position": None,
        "expected_end": None,
        "awaited": None,
    }
