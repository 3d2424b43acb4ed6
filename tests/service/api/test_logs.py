"""Logs for machines: one JSON object a line, found again by the identifier of a request."""

import json
import logging
import sys

import httpx
import pytest

from steradian.runtime.logs import _Json, _Text, request_id
from support.apis import ApiProcess


@pytest.fixture(scope="module")
def talk(tmp_path_factory):
    """What three requests are answered, and what the process logged meanwhile."""
    api = ApiProcess(tmp_path_factory.mktemp("logs"), log_format="json", log_level="DEBUG").wait()
    url = api.url
    answers = [
        httpx.get(f"{url}/api/v1/scans/none", headers={"X-Request-ID": "mine-1"}, timeout=90),
        httpx.get(
            f"{url}/api/v1/scans?ticket=secret-ticket", headers={"X-Request-ID": "bad id\x7f".strip("\x7f")}, timeout=90
        ),
        httpx.get(f"{url}/healthz", timeout=90),
    ]
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
    assert len(set(identifiers)) == 3
    assert " " not in identifiers[1]


def test_what_stands_in_a_query_is_in_no_log(talk):
    _, lines = talk
    assert "secret-ticket" not in json.dumps(lines)


def test_an_exception_and_what_was_given_beside_the_message_are_in_the_object():
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
    assert "[request r-7]" in text
