"""Those who read the same thing in the same moment share one look at it, and none is told what is out of date."""

import asyncio
import threading
import uuid

import httpx

from steradian.api.together import Together


class Counting:
    """An application that answers with how often it was asked, after a while."""

    def __init__(self, status=200):
        self.asked, self.status = 0, status

    async def __call__(self, scope, receive, send):
        self.asked += 1
        body = str(self.asked).encode()
        await asyncio.sleep(0.05)
        await send({"type": "http.response.start", "status": self.status, "headers": []})
        await send({"type": "http.response.body", "body": body})


async def ask(app, path="/api/v1/masks", principal="a", headers=(), method="GET"):
    sent = []

    async def send(message):
        sent.append(message)

    scope = {"type": "http", "method": method, "path": path, "query_string": b"", "headers": list(headers)}
    await app(scope | {"state": {"principal": principal}}, None, send)
    return int(sent[1]["body"])


def test_a_hundred_readers_cost_two_looks():
    async def run():
        inner = Counting()
        app = Together(inner)
        found = await asyncio.gather(*(ask(app) for _ in range(100)))
        assert sorted(found) == [1] + [2] * 99, "the first, and those who came while its look was under way"
        assert await ask(app) == 3

    asyncio.run(run())


def test_other_readers_other_things_and_other_deeds_share_nothing():
    async def run():
        inner = Counting()
        app = Together(inner)
        several = [
            {}, {"principal": "b"}, {"path": "/api/v1/plans"}, {"headers": [(b"accept", b"text/csv")]},
            {"headers": [(b"prefer", b"wait=1")]}, {"method": "POST"}, {"path": "/api/v1/masks/m1/points"},
        ]  # fmt: skip
        await asyncio.gather(*(ask(app, **one) for one in several))
        assert inner.asked == len(several)
        failing = Counting(503)
        app = Together(failing)
        found = await asyncio.gather(*(ask(app) for _ in range(5)))
        assert len(set(found)) == 5, "a problem names the request that met it"

    asyncio.run(run())


def test_what_was_written_is_read_by_whoever_asks_afterwards(server, scan):
    """While many read the same scan without pause, a label that was set is there for the very next reader."""
    address, over, refused = f"{server.url}/api/v1/scans/{scan['id']}", threading.Event(), []

    def read():
        with httpx.Client(timeout=60) as http:
            while not over.is_set():
                if http.get(address).status_code != 200:
                    refused.append(1)

    readers = [threading.Thread(target=read) for _ in range(12)]
    for reader in readers:
        reader.start()
    try:
        with httpx.Client(timeout=60) as http:
            for _ in range(60):
                label = uuid.uuid4().hex
                http.patch(address, json={"labels": {"now": label}}).raise_for_status()
                assert http.get(address).json()["labels"]["now"] == label
    finally:
        over.set()
        for reader in readers:
            reader.join()
    assert not refused
