"""The event log tells when a batch moves on and when a job is moved in the queue, and streams tell it in pieces."""

import asyncio
import re
import threading
from contextlib import aclosing
from datetime import UTC, datetime

import pytest

from steradian.api.app import create_app
from steradian.api.routers.events import BATCH, EventFilter, _stream_events
from steradian.jobs.job import Failed, Succeeded
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.security.keys import Principal, Scope
from steradian.storage.repositories.event_log import EventLog, append_event

SOMEBODY = Principal("ada", frozenset({Scope.READ}))


@pytest.fixture
def events(server):
    """Tells what was logged of a resource since the test began."""
    log = EventLog(server.database)
    begun = log.bounds().last

    def of(identifier):
        return [one for one in log.after(begun, 10_000) if one.resource_id == identifier]

    return of


@pytest.fixture
def ledger(server):
    return JobLedger(server.database)


def batch_of(http, scan_id, count):
    asked = {"scan_id": scan_id, "vary": {"modes": [4 + 2 * one for one in range(count)]}}
    return http.post("/batches", json=asked).json()


def test_job_priority_change_sends_event(http, events, scan_with_alines):
    job = scan_with_alines["reconstruction"]["id"]
    before = events(job)
    assert before[-1].data["priority"] == 100
    for priority in (7, 7):  # the second changes nothing
        assert http.patch(f"/jobs/{job}", json={"priority": priority}).status_code == 200
    (moved,) = events(job)[len(before) :]
    assert (moved.kind, moved.scan_id) == ("reconstruction", scan_with_alines["scan"]["id"])
    assert {name: moved.data[name] for name in ("state", "priority", "who")} == {
        "state": "queued",
        "priority": 7,
        "who": "local",
    }
    http.patch(f"/reconstructions/{job}", json={"priority": 8})
    assert events(job)[-1].data["priority"] == 8


@pytest.mark.parametrize("ends", ["succeeded", "failed", "cancelled"])
def test_batch_event_is_sent_with_counts_on_each_job_change(http, events, ledger, scan_with_alines, ends):
    batch = batch_of(http, scan_with_alines["scan"]["id"], 3)
    assert [one.data["state"] for one in events(batch["id"])] == ["queued"]
    first, second, third = (job["id"] for job in batch["jobs"])
    for job in (first, second):
        ledger.start_attempt(job, "w")
        told = events(batch["id"])[-1].data
        now = http.get(f"/batches/{batch['id']}").json()
        assert (told["state"], told["counts"], told["scan_id"]) == ("running", now["counts"], batch["scan_id"])
        ledger.finish_attempt(job, 1, Succeeded({"shape": [1]}) if ends != "failed" else Failed("bad", "no"), "w")
    if ends == "cancelled":
        http.put(f"/batches/{batch['id']}/desired-state", json={"state": "cancelled", "reason": "enough"})
    else:
        ledger.start_attempt(third, "w")
        ledger.finish_attempt(third, 1, Succeeded({"shape": [1]}), "w")
    now = http.get(f"/batches/{batch['id']}").json()
    told = events(batch["id"])[-1]
    assert (told.kind, told.data["state"], told.data["counts"]) == ("batch", ends, now["counts"])
    assert now["state"] == ends
    assert told.scan_id == batch["scan_id"]


def test_concurrent_job_ends_send_final_batch_event(http, events, ledger, scan_with_alines):
    """Each of two workers must not see the other's job still running."""
    for _ in range(5):
        batch = batch_of(http, scan_with_alines["scan"]["id"], 2)
        jobs = [job["id"] for job in batch["jobs"]]
        for job in jobs:
            ledger.start_attempt(job, "w")
        meet = threading.Barrier(2)

        def end(job, meet=meet):
            meet.wait()
            ledger.finish_attempt(job, 1, Succeeded({"shape": [1]}), "w")

        threads = [threading.Thread(target=end, args=(job,)) for job in jobs]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert events(batch["id"])[-1].data["state"] == "succeeded"


def test_event_stream_backlog_is_sent_in_bounded_chunks(server):
    """Days of events are not gathered in memory before the first of them is sent."""
    state = create_app(server.settings).state
    begun, missed = EventLog(server.database).bounds(), 3 * BATCH + 8
    with server.database.write() as session:
        for number in range(missed):
            scan_id = "s1" if number % 3 else "s2"
            append_event(session, datetime.now(UTC), "job", f"missed-{number}", {"scan_id": scan_id})

    async def follow(scan_id):
        """Return the numbers of these events in the stream; the server may log others before and after them."""
        wanted, told = EventFilter(None, scan_id, False, f"{begun.epoch}.{begun.last}"), []
        async with aclosing(_stream_events(state.services, SOMEBODY, state.feed, wanted)) as frames:
            async for piece in frames:
                assert len(re.findall(rb"^id: ", piece, re.M)) <= BATCH
                told += [int(number) for number in re.findall(rb'"id": "missed-(\d+)"', piece)]
                if told[-1:] == [missed - 1]:
                    return told

    for scan_id in (None, "s1"):
        assert asyncio.run(follow(scan_id)) == [each for each in range(missed) if scan_id is None or each % 3]
    state.services.database.close()
