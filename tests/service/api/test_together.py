"""Those who read the same thing in the same moment share one look at it, and none is told what is out of date."""

import asyncio
import threading
import uuid

import httpx
import pytest

from steradian.api.background.batcher import BatchLoader
from steradian.api.middleware.response_cache import MAX_BYTES, MAX_ENTRY_BYTES, CoalescingCacheMiddleware
from steradian.api.middleware.validator_loader import CacheValidatorLoader, validator_key
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.repositories.validators import ValidatorKey
from steradian.storage.state_machines import ScanState

from .conftest import EQUI


class Counting:
    """An application that answers with how often it was asked, after a while."""

    def __init__(self, status=200, size=0):
        self.asked, self.status, self.size = 0, status, size

    async def __call__(self, scope, receive, send):
        self.asked += 1
        body = str(self.asked).encode().rjust(self.size)
        await asyncio.sleep(0.05)
        await send({"type": "http.response.start", "status": self.status, "headers": []})
        await send({"type": "http.response.body", "body": body})


async def nothing(_scope):
    return ()


async def ask(app, path="/api/v1/masks", principal="a", headers=(), method="GET"):
    sent = []

    async def send(message):
        sent.append(message)

    scope = {"type": "http", "method": method, "path": path, "query_string": b"", "headers": list(headers)}
    await app(scope | {"state": {"principal": principal}}, None, send)
    return int(sent[1]["body"].strip())


def test_concurrent_identical_requests_run_handler_twice():
    async def run():
        inner = Counting()
        app = CoalescingCacheMiddleware(inner, nothing)
        found = await asyncio.gather(*(ask(app) for _ in range(100)))
        assert sorted(found) == [1] + [2] * 99, "the first, and those who came while its look was under way"
        assert await ask(app) == 3

    asyncio.run(run())


def test_other_readers_other_things_and_other_deeds_share_nothing():
    async def run():
        inner = Counting()
        app = CoalescingCacheMiddleware(inner, nothing)
        several = [
            {}, {"principal": "b"}, {"path": "/api/v1/plans"}, {"headers": [(b"accept", b"text/csv")]},
            {"headers": [(b"prefer", b"wait=1")]}, {"method": "POST"}, {"path": "/api/v1/masks/m1/points"},
        ]  # fmt: skip
        await asyncio.gather(*(ask(app, **one) for one in several))
        assert inner.asked == len(several)
        failing = Counting(503)
        app = CoalescingCacheMiddleware(failing, nothing)
        found = await asyncio.gather(*(ask(app) for _ in range(5)))
        assert len(set(found)) == 5, "a problem names the request that met it"

    asyncio.run(run())


@pytest.mark.long
def test_read_after_write_returns_new_label_under_concurrent_reads(server, scan):
    """While many read the same scan without pause, a label that was set is there for the very next reader."""
    address, over, refused = f"{server.url}/api/v1/scans/{scan['id']}", threading.Event(), []

    def read():
        with httpx.Client(timeout=250) as http:
            while not over.is_set():
                if http.get(address).status_code != 200:
                    refused.append(1)

    readers = [threading.Thread(target=read) for _ in range(12)]
    for reader in readers:
        reader.start()
    try:
        with httpx.Client(timeout=250) as http:
            for _ in range(60):
                label = uuid.uuid4().hex
                http.patch(address, json={"labels": {"now": label}}).raise_for_status()
                assert http.get(address).json()["labels"]["now"] == label
    finally:
        over.set()
        for reader in readers:
            reader.join()
    assert not refused


def test_cached_response_is_kept_until_validator_changes():
    async def run():
        stamps, inner = {"/api/v1/masks": (1,)}, Counting()

        async def stamp(scope):
            return stamps.get(scope["path"], ())

        app = CoalescingCacheMiddleware(inner, stamp)
        assert [await ask(app) for _ in range(3)] == [1, 1, 1]
        assert await ask(app, principal="b") == 2, "what somebody else was told is not for others"
        assert await ask(app, headers=[(b"if-none-match", b'"x"')]) == 3
        stamps["/api/v1/masks"] = (2,)
        assert [await ask(app) for _ in range(2)] == [4, 4]
        assert [await ask(app, path="/api/v1/batches") for _ in range(2)] == [5, 6], "nothing is known of it"
        failing = CoalescingCacheMiddleware(Counting(404), stamp)
        assert [await ask(failing) for _ in range(2)] == [1, 2], "a problem names the request that met it"

    asyncio.run(run())


def test_response_cache_evicts_oldest_and_skips_oversized_entries():
    async def run():
        async def stamp(_scope):
            return (1,)

        inner = Counting(size=MAX_ENTRY_BYTES)
        app, most = CoalescingCacheMiddleware(inner, stamp), MAX_BYTES // MAX_ENTRY_BYTES
        paths = [f"/api/v1/masks/m{number}" for number in range(most + 1)]
        for path in paths:
            await ask(app, path=path)
        assert await ask(app, path=paths[-1]) == most + 1, "the newest are kept"
        assert await ask(app, path=paths[0]) == most + 2, "the oldest had to go"
        large = CoalescingCacheMiddleware(Counting(size=MAX_ENTRY_BYTES + 1), stamp)
        assert [await ask(large) for _ in range(2)] == [1, 2]

    asyncio.run(run())


def test_validator_key_covers_only_supported_paths_and_queries():
    def asked(path, query=b""):
        return validator_key({"path": f"/api/v1/{path}", "query_string": query})

    assert asked("jobs/j1") == ValidatorKey("jobs", "j1")
    assert asked("scans") == ValidatorKey("scans")
    assert asked("scans", b"limit=7&before=12") == ValidatorKey("scans", None, 7, 12)
    assert asked("scans/s1/coverage") == ValidatorKey("scans", "s1"), "what is measured grows with the scan's progress"
    for path in ("scanners", "batches", "scans/s1/alines", "masks/m1/coverage"):
        assert asked(path) is None
    for query in (b"kind=export", b"limit=0", b"limit=2&limit=3", b"before=1", b"limit=1&before=99999999999"):
        assert asked("jobs", query) is None


@pytest.mark.long
def test_cached_response_equals_uncached_after_each_change(server, http, scan_with_alines):
    """Whatever changes of a row, also in other processes, the next reader is told."""
    scan, job = scan_with_alines["scan"]["id"], scan_with_alines["reconstruction"]["id"]
    plan, mask = scan_with_alines["scan"]["plan_id"], scan_with_alines["scan"]["mask_id"]
    ones = {"scans": scan, "jobs": job, "reconstructions": job, "plans": plan, "masks": mask}
    paths = [*ones, *(f"{noun}?limit=1" for noun in ones), *(f"{noun}/{one}" for noun, one in ones.items())]
    paths.append(f"scans/{scan}/coverage")
    ledger, scans = JobLedger(server.database), ScanRepository(server.database)
    other = {"arrangement": "grid", "aperture": 0.01, "count": 3, "interval": 1e-3}

    more = {"scan_id": scan, "parameters": {"modes": 32}, "priority": 0}

    def newest():
        return http.post("/masks", json=other).json()["id"]

    def settled():
        return ledger.start_attempt(job, "test").fence

    changes = [
        lambda: None,
        lambda: ledger.report(job, settled(), "migration", 3, 10),
        lambda: ledger.report(job, ledger.get(job).fence, "migration", 4, 10),
        lambda: ledger.requeue(job, ledger.get(job).fence, "test"),
        lambda: http.patch(f"/jobs/{job}", json={"priority": 7}).raise_for_status(),
        lambda: http.post("/reconstructions", json=more).raise_for_status(),  # comes before it
        lambda: http.put(f"/jobs/{job}/desired-state", json={"state": "cancelled"}).raise_for_status(),
        lambda: scans.label(scan, {"phantom": "yarn"}),
        lambda: scans.report(scan, "over", 5, 69),
        lambda: http.post("/masks", json=EQUI | {"count": 77}).raise_for_status(),
        newest,
        lambda: http.delete(f"/masks/{newest()}").raise_for_status(),
        newest,
        lambda: http.delete(f"/jobs/{job}"),
    ]
    for number, change in enumerate(changes):
        change()
        for path in paths:
            made = http.get(f"/{path}", headers={"Prefer": "respond-async"})  # shares nothing
            for _ in range(2):
                given = http.get(f"/{path}")
                told = (given.status_code, given.headers.get("ETag"), given.headers.get("Link"))
                assert told == (made.status_code, made.headers.get("ETag"), made.headers.get("Link")), (number, path)
                if given.is_success:
                    assert given.json() == made.json(), (number, path)
    assert scans.get(scan).state is ScanState.PARTIAL


def test_stamps_that_are_asked_for_together_cost_one_look(server, mask):
    async def run():
        stamps, looks = CacheValidatorLoader(server.database), []
        plain = stamps._looks._look
        stamps._looks._look = lambda questions: looks.append(len(questions)) or plain(questions)
        scopes = [{"path": f"/api/v1/masks/{mask['id'] if even else 'm0'}", "query_string": b""} for even in (1, 0)]
        found = await asyncio.gather(*(stamps.of(scope) for scope in scopes * 20))
        assert looks == [2]
        assert found == [found[0], ()] * 20
        assert found[0][0] == mask["id"]

    asyncio.run(run())


def test_batch_loader_missing_key_raises_key_error():
    forgotten = {1}

    def look(questions):
        return {question: question for question in questions if question not in forgotten}

    async def everybody():
        looks = BatchLoader(look)
        with pytest.raises(KeyError):
            await asyncio.wait_for(looks.load(1), 60)
        forgotten.clear()
        return await asyncio.wait_for(asyncio.gather(looks.load(1), looks.load(2)), 60)

    assert asyncio.run(everybody()) == [1, 2]
