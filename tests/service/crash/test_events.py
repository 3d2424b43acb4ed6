"""A listener that is cut off again and again misses nothing, sees nothing twice, and is told when it must reload."""

import contextlib
import json
import time
from datetime import UTC, datetime, timedelta

import httpx
import pytest

from steradian.storage.repositories.event_log import EventLog

CUTS, JOBS = 50, 10
pytestmark = [pytest.mark.crash, pytest.mark.timeout(180)]


@pytest.fixture
def service(embedded):
    return embedded


def read_events(lines):
    """Parse a stream of server-sent events into (name, id, data)."""
    event = {}
    for line in lines:
        if not line and event:
            yield event.get("event"), event.get("id"), json.loads(event["data"]) if "data" in event else None
            event = {}
        name, _, value = line.partition(": ")
        if name in {"event", "id", "data"}:
            event[name] = value


class Listener:
    def __init__(self, url):
        self.http = httpx.Client(timeout=90)
        self.url, self.last, self.seen, self.progress, self.resets = f"{url}/api/v1/events", None, [], [], 0

    def listen_for(self, seconds):
        """Connect, listen for a while and cut the connection, wherever the stream is."""
        end = time.monotonic() + seconds
        with contextlib.suppress(httpx.ReadTimeout):
            self.listen(lambda _name: time.monotonic() > end, timeout=seconds)

    def listen(self, until, timeout=20):
        """Connect and take events until ``until`` says so; then the connection is cut."""
        headers = {} if self.last is None else {"Last-Event-ID": self.last}
        with self.http.stream("GET", self.url, headers=headers, timeout=timeout) as answer:
            assert answer.headers["content-type"].startswith("text/event-stream")
            for name, identifier, data in read_events(answer.iter_lines()):
                self.last = identifier or self.last
                self.resets += name == "reset"
                if name == "progress":
                    self.progress.append((time.monotonic(), data))
                elif name not in {"ready", "reset"}:
                    self.seen.append((int(identifier.rpartition(".")[2]), name, data["id"], data["state"]))
                if until(name):
                    return


def test_fifty_cuts_during_a_scan_and_ten_jobs(service, capsys):
    """Every change of state is seen exactly once and in order, whatever was cut."""
    listener = Listener(service.url)
    listener.listen(lambda name: name == "ready")
    scan = service.start_scan(service.plan(pulse_rate=1))["id"]
    names = [service.submit(f"job-{number}", "succeed", answer=number, seconds=0.2) for number in range(JOBS)]
    for cut in range(CUTS):
        listener.listen_for(0.05 + 0.01 * (cut % 10))
    service.until(lambda: all(service.queue.status(name).is_over for name in names), 60)
    service.until(lambda: httpx.get(f"{service.url}/api/v1/scans/{scan}", timeout=90).json()["state"] == "complete", 60)
    logged = [
        (event.sequence, event.kind, event.resource_id, event.data["state"])
        for event in EventLog(service.queue.ledger.database).after(int(listener.seen[0][0]) - 1, 10_000)
    ]
    listener.listen(lambda _name: listener.seen[-1][0] >= logged[-1][0])
    assert listener.seen == logged
    assert listener.resets == 0
    states = [state for _, _, identifier, state in listener.seen if identifier == scan]
    assert states == ["queued", "arming", "running", "completing", "complete"]
    for name in names:
        assert [s for _, _, identifier, s in listener.seen if identifier == name] == ["queued", "running", "succeeded"]
    with capsys.disabled():
        print(f"\n  {CUTS} cuts, {len(names)} jobs, 1 scan: {len(logged)} changes, each seen once, in order")


def test_progress_events_are_rate_limited_and_include_eta(service):
    listener = Listener(service.url)
    scan = service.start_scan(service.plan(pulse_rate=1))["id"]
    listener.listen(lambda name: len(listener.progress) == 8)
    times = [when for when, data in listener.progress if data["id"] == scan]
    assert times[-1] - times[0] > (len(times) - 1) * 0.15
    assert any(data["eta"] for _, data in listener.progress)
    assert all(0 <= data["done"] <= data["total"] for _, data in listener.progress)


def test_pruned_event_position_sends_reset(service):
    listener = Listener(service.url)
    listener.listen(lambda name: name == "ready")
    service.submit("one", "succeed", answer=1)
    service.until(lambda: service.queue.status("one").is_over, 40)
    EventLog(service.queue.ledger.database).prune(datetime.now(UTC) + timedelta(seconds=1))
    listener.listen(lambda name: name == "reset")
    assert listener.resets == 1
    service.submit("two", "succeed", answer=1)
    listener.listen(lambda name: name == "job")
    assert listener.seen[-1][2:] == ("two", "queued"), "from there on nothing is missed"
    listener.last = "another.7"
    listener.listen(lambda name: name == "reset")
    assert listener.resets == 2
