"""Requests under way when the API shuts down."""

import json
import socket

import httpx
import pytest

from support.waiting import until

from .conftest import api_of

HALF = b"POST /api/v1/masks HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 999\r\n\r\n{"


@pytest.mark.long
def test_request_cut_off_by_shutdown_is_answered_503_without_traceback(tmp_path):
    api = api_of(tmp_path).wait()
    with socket.create_connection(("127.0.0.1", int(api.url.rpartition(":")[2]))) as client:
        client.sendall(HALF)
        until(lambda: httpx.get(f"{api.url}/healthz", timeout=60).is_success)  # the half request has been read before
        api.close()
        head, _, body = client.makefile("rb").read().partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 503 ")
    assert b"retry-after: 5" in head.lower()
    assert json.loads(body)["code"] == "shutting-down"
    assert "Traceback" not in api.log
