"""A node that takes connections and says nothing."""

import socket

import anyio
from starlette.requests import Request

from steradian.api.background import peers as nodes
from steradian.core.settings import Settings
from steradian.security.keys import Principal
from steradian.storage.db.tables import ScannerRow


def request():
    async def receive():
        return {"type": "http.request", "body": b"", "more_body": False}

    state = {"request_id": "r1", "principal": Principal("ann", frozenset(), None)}
    scope = {"type": "http", "method": "GET", "raw_path": b"/api/v1/scans/s1/file", "query_string": b"", "headers": []}
    return Request(scope | {"path": "/", "state": state}, receive)


def test_request_queued_behind_hung_forwards_fails_before_they_end(tmp_path, monkeypatch):
    monkeypatch.setattr(nodes, "AT_ONCE", 1)
    monkeypatch.setattr(nodes, "PATIENCE", 0.2)  # of who waits for a place: the answer is waited for as long as ever
    known = nodes.PeerRegistry(Settings.create(data=tmp_path, node_secret="x" * 32), None)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"http://127.0.0.1:{silent.getsockname()[1]}"
        known._rows = {"scanner-1": ScannerRow(id="scanner-1", address=address)}
        told = []

        async def ask():
            try:
                await known.forward(request(), "scanner-1")
            except nodes.NodeUnavailable as error:
                told.append(str(error))
                silent.close()  # upon which the other one ends, too

        async def both():
            async with anyio.create_task_group() as group:
                group.start_soon(ask)
                await anyio.wait_all_tasks_blocked()
                group.start_soon(ask)

        anyio.run(both)
    assert "other requests wait for its answer" in told[0]
    assert "does not answer" in told[1]
