"""Logs for machines: one JSON object a line, found again by the identifier of a request."""

import fcntl
import json
import logging
import os
import socket
import sys

import httpx
import pytest

from steradian.core.logging_config import _Json, _Text, request_id
from support.apis import ApiProcess

FORGED = {
    "folded": b"forged\r\n forged-line",
    "long": b"forged" * 1700,
    "quoted": b'forged"}{"level":"ERROR',
    "escaped": b"forged\\n2026",
    "control": b"forged\x1b[2K",
    "not ASCII": "forged\N{LINE SEPARATOR}".encode(),
}
"""Identifiers that a log should not be made to hold, as they are sent."""
MASK = b'{"arrangement": "grid", "aperture": 0.01, "interval": 0.001, "count": 4}'


def forge(url, header):
    """Make a mask under an identifier that no client's library would send; returns the answer."""
    host, port = url.removeprefix("http://").split(":")
    head = b"POST /api/v1/masks HTTP/1.1\r\nHost: %s\r\nConnection: close\r\nContent-Type: application/json\r\n"
    about = b"X-Request-ID: %s\r\nContent-Length: %d\r\n\r\n" % (header, len(MASK))
    with socket.create_connection((host, int(port)), timeout=250) as connection:
        connection.sendall(head % host.encode() + about + MASK)
        return connection.makefile("rb").read()


@pytest.fixture(scope="module")
def forged():
    """What those who forge identifiers are answered, filled by the talk."""
    return {}


@pytest.fixture(scope="module")
def talk(tmp_path_factory, forged):
    """What some requests are answered, and what the process logged meanwhile."""
    api = ApiProcess(tmp_path_factory.mktemp("logs"), log_format="json", log_level="DEBUG").wait()
    url = api.url
    answers = [
        httpx.get(f"{url}/api/v1/scans/none", headers={"X-Request-ID": "mine-1"}, timeout=250),
        httpx.get(f"{url}/api/v1/scans?ticket=secret-ticket", headers={"X-Request-ID": "bad id"}, timeout=250),
        httpx.get(f"{url}/healthz", timeout=250),
        httpx.post(f"{url}/api/v1/masks", json=json.loads(MASK), headers={"X-Request-ID": "mine-2"}, timeout=250),
    ]
    forged |= {name: forge(url, header) for name, header in FORGED.items()}
    api.close()
    return answers, [json.loads(line) for line in api.log.splitlines()]


def test_every_line_is_one_object_with_time_level_and_process(talk):
    _, lines = talk
    assert lines
    for line in lines:
        assert {"at", "level", "process", "logger", "message"} <= set(line)
        assert line["process"] == "api"


def test_a_request_is_found_in_the_log_by_its_identifier(talk):
    answers, lines = talk
    assert answers[0].headers["x-request-id"] == answers[0].json()["request_id"] == "mine-1"
    (line,) = [line for line in lines if line.get("request_id") == "mine-1" and "path" in line]
    assert (line["method"], line["path"], line["status"]) == ("GET", "/api/v1/scans/none", 404)
    assert line["milliseconds"] >= 0


def test_an_identifier_that_is_none_is_replaced_and_every_answer_has_its_own(talk):
    answers, _ = talk
    identifiers = [answer.headers["x-request-id"] for answer in answers]
    assert len(set(identifiers)) == 4
    assert " " not in identifiers[1]


def test_info_log_names_created_resources_and_omits_reads(talk):
    answers, lines = talk
    usual = [line for line in lines if line["level"] == "INFO" and "path" in line]
    assert {line["path"] for line in usual} == {"/api/v1/masks"}
    (line,) = [line for line in usual if line["request_id"] == "mine-2"]
    assert line["location"] == answers[3].headers["location"]
    assert line["message"].endswith(answers[3].headers["location"])


@pytest.mark.parametrize("name", FORGED)
def test_an_identifier_that_would_forge_a_log_is_refused_or_replaced(talk, forged, name):
    head = forged[name].partition(b"\r\n\r\n")[0]
    assert head.split()[1] in (b"200", b"201", b"400", b"431"), head
    assert b"forged" not in head
    assert "forged" not in json.dumps(talk[1])


def test_log_contains_no_query_string(talk):
    _, lines = talk
    assert "secret-ticket" not in json.dumps(lines)


def test_log_formatter_includes_exception_and_extra_fields():
    try:
        raise ZeroDivisionError("oh")
    except ZeroDivisionError:
        record = logging.getLogger("x").makeRecord("x", logging.ERROR, "f", 1, "it failed", (), sys.exc_info(), "g")
    record.scan = "s1"
    token = request_id.set("r-7")
    try:
        entry = json.loads(_Json("worker-0").format(record))
        text = _Text("worker-0").format(record)
    finally:
        request_id.reset(token)
    assert (entry["scan"], entry["request_id"], entry["message"]) == ("s1", "r-7", "it failed")
    assert "ZeroDivisionError: oh" in entry["exception"]
    assert text.splitlines()[0].endswith("it failed [request r-7]"), "before the traceback, where it is looked for"


@pytest.mark.long
def test_blocked_log_pipe_delays_no_request_or_emergency_stop(tmp_path):
    reader, writer = os.pipe()
    fcntl.fcntl(writer, fcntl.F_SETPIPE_SZ, 4096)
    api = ApiProcess(tmp_path, preexec_fn=lambda: os.dup2(writer, 2), log_level="DEBUG").wait()
    os.close(writer)
    with open(reader, encoding="utf-8") as read:
        try:
            for _ in range(60):
                httpx.post(f"{api.url}/api/v1/masks", json=json.loads(MASK), timeout=100).raise_for_status()
            stop = f"{api.url}/api/v1/scanners/scanner-0/emergency-stop"
            assert httpx.post(stop, json={"reason": "smoke"}, timeout=100).is_success
        finally:
            api.close()
        assert 0 < read.read().count("POST /api/v1/masks") < 60, "it was full"
