"""What a node without a scanner is asked about one goes to the scanner's, and a press of the stop until it arrives."""

import re
import socket
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import httpx
import pytest

from steradian.api.background import peers as nodes
from steradian.storage.data_dir.emergency_latch import StopOutcome
from steradian.storage.data_dir.fault_requests import ClearAnswer, ClearFaultRequest
from steradian.storage.db.tables import EventRow
from support.apis import ApiProcess
from support.pairs import NOBODY, SECRET, Pair
from support.waiting import until

pytestmark = pytest.mark.long

STOP = "/scanners/scanner-0/emergency-stop"


@pytest.fixture
def pair(tmp_path):
    pair = Pair(tmp_path)
    yield pair
    pair.close()


@pytest.fixture(scope="module")
def shared_pair(tmp_path_factory):
    """Pair of nodes for all tests that leave no press and no other scanner behind."""
    pair = Pair(tmp_path_factory.mktemp("pair"))
    yield pair
    pair.close()


def test_a_press_is_answered_by_the_scanner_s_node_and_its_release_too(shared_pair):
    answer = shared_pair.http.post(STOP, json={"reason": "smoke"})
    assert answer.status_code == 202, answer.text
    press, shown = shared_pair.latch.active(), answer.json()["emergency_stop"]
    assert (press.number, press.who, press.reason) == (shown["number"], "local", "smoke")
    shared_pair.latch.record_outcome(StopOutcome(press.number, "off", 0.01))
    until(
        lambda: (
            (seen := shared_pair.http.get("/scanners/scanner-0").json()["emergency_stop"]) and seen["laser"] == "off"
        )
    )
    refused = shared_pair.http.delete(STOP, params={"number": "another"})
    assert (refused.status_code, refused.json()["code"]) == (409, "emergency-stopped")
    assert shared_pair.http.delete(STOP, params={"number": press.number}).json()["emergency_stop"] is None
    assert shared_pair.latch.active() is None
    assert shared_pair.http.post("/scanners/scanner-9/emergency-stop").status_code == 404


def test_clear_fault_on_a_node_without_the_scanner_is_carried_out_and_recorded_by_the_scanners_node(shared_pair):
    clearing = ClearFaultRequest(shared_pair.scanner.data.emergency)

    def answer_with(*about):
        request = until(clearing.asked)
        clearing.answer(ClearAnswer(request.number, *about))
        return request.who

    with ThreadPoolExecutor(1) as acquisition:
        who = acquisition.submit(answer_with, "interlock-opened")
        cleared = shared_pair.http.post("/scanners/scanner-0/clear-fault", json={"reason": "closed"})
        assert (cleared.status_code, who.result()) == (200, "local"), cleared.text
    with shared_pair.database.read() as session:
        told = [row.data for row in session.query(EventRow).where(EventRow.kind == "scanner")]
    assert ("local", "fault cleared: interlock-opened: closed") in [(one["who"], one["why"]) for one in told]


def test_clear_fault_without_acquisition_process_returns_503(shared_pair):
    refused = shared_pair.http.post("/scanners/scanner-0/clear-fault")
    assert (refused.status_code, refused.json()["code"]) == (503, "scanner-unreachable")
    assert "acquisition process" in refused.json()["detail"]


def test_undelivered_stop_is_stored_and_applied_on_scanner_restart(pair):
    pair.scanner.close()
    answer = pair.http.post(STOP, json={"reason": "smoke"})
    assert (answer.status_code, answer.json()["emergency_stop"]["laser"]) == (202, "unconfirmed")
    released = pair.http.delete(STOP)
    assert (released.status_code, released.json()["code"]) == (503, "node-unavailable")
    until(lambda: pair.http.get("/scanners/scanner-0").json()["emergency_stop"])
    assert pair.latch.active() is None
    pair.scanner = pair.start()
    assert until(pair.latch.active).reason == "smoke"
    pair.row.ensure(simulated=True, address=pair.scanner.url)
    number = answer.json()["emergency_stop"]["number"]
    released = until(lambda: (gone := pair.http.delete(STOP, params={"number": number})).status_code != 503 and gone)
    assert released.is_success, "who pressed knows the number of the press, though nobody had confirmed it"
    assert released.json()["emergency_stop"] is None


def test_stop_all_lists_every_scanner_and_marks_unreachable_unconfirmed(pair):
    pair.row.of("scanner-1").ensure(simulated=True, address=NOBODY)
    until(lambda: "refused" in pair.http.delete("/scanners/scanner-1/emergency-stop").text)
    answer = pair.http.post("/emergency-stop", json={"reason": "smoke"})
    assert answer.status_code == 202, answer.text
    said = {one["id"]: one["emergency_stop"] for one in answer.json()["items"]}
    assert set(said) == {"scanner-0", "scanner-1"}
    assert said["scanner-0"]["number"] == pair.latch.active().number
    assert said["scanner-1"]["laser"] == "unconfirmed"


def test_stop_all_reaches_cached_scanners_while_database_is_locked(pair):
    pair.row.of("scanner-1").ensure(simulated=True, address=NOBODY)
    until(lambda: "refused" in pair.http.delete("/scanners/scanner-1/emergency-stop").text)
    with pair.scanner.database.write():  # what a database does that hangs
        answer = pair.http.post("/emergency-stop")
        assert {one["id"] for one in answer.json()["items"]} == {"scanner-0", "scanner-1"}
        assert pair.latch.active() is not None


def test_a_node_that_answers_in_drops_is_asked_again(pair):
    """Each drop in time, the whole never: a press must not wait for that."""
    with socket.create_server(("127.0.0.1", 0), backlog=100) as slow, ThreadPoolExecutor(1) as node:
        slow.settimeout(0.3)
        again = node.submit(dripping, slow)
        pair.row.of("scanner-1").ensure(simulated=True, address=f"http://127.0.0.1:{slow.getsockname()[1]}")
        path = "/scanners/scanner-1/emergency-stop"
        until(lambda: pair.http.post(path).status_code == 202)
        asked = again.result()
    errands = {re.search(rb"(?i)steradian-errand: (\S+)", each)[1] for each in asked}
    assert len(errands) == 1, "it is the same press"


def dripping(server):
    """Answer in drops whoever comes first, until he comes again; returns what he asked each time."""
    come = []
    deadline = time.monotonic() + 250
    while len(come) < 2:
        assert time.monotonic() < deadline, "nobody came again"
        with suppress(TimeoutError):
            come.append(server.accept()[0])
        for first in come[:1]:
            with suppress(OSError):
                first.sendall(b"H")
    asked = [each.recv(65_536) for each in come]
    for each in come:
        each.close()
    return asked


class Echo(BaseHTTPRequestHandler):
    """Tells which headers it got, and says some of its own twice."""

    def do_DELETE(self):
        self.server.seen = self.headers.get_all("Accept")
        self.send_response(200)
        for name, value in (("Link", "<a>; rel=a"), ("Link", "<b>; rel=b"), ("Content-Length", "2")):
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(b"{}")

    def log_message(self, *_):
        """Nothing."""


def test_headers_that_come_twice_are_sent_on_and_back_twice(pair):
    with ThreadingHTTPServer(("127.0.0.1", 0), Echo) as echo:
        thread = threading.Thread(target=echo.serve_forever)
        thread.start()
        pair.row.of("scanner-1").ensure(simulated=True, address=f"http://127.0.0.1:{echo.server_port}")
        said = [("Accept", "application/json"), ("Accept", "text/html")]
        path = "/scanners/scanner-1/emergency-stop"
        answer = until(lambda: (given := pair.http.delete(path, headers=said)).is_success and given)
        echo.shutdown()
        thread.join()
    assert echo.seen[-2:] == ["application/json", "text/html"]
    assert answer.headers.get_list("Link") == ["<a>; rel=a", "<b>; rel=b"]


@pytest.mark.parametrize("errand", ["", "01"])
def test_only_another_node_can_say_that_a_press_is_one_that_came_before(shared_pair, errand):
    for _ in range(2):
        asked = httpx.post(f"{shared_pair.scanner.url}/api/v1{STOP}", headers={"Steradian-Errand": errand}, timeout=250)
        press = shared_pair.latch.active()
        assert press is not None, "it is pressed anew"
        assert asked.json()["emergency_stop"]["number"] == press.number
        httpx.delete(f"{shared_pair.scanner.url}/api/v1{STOP}", timeout=250).raise_for_status()


def test_forwarded_principal_without_node_secret_returns_401(shared_pair):
    said = {"Steradian-Principal": '{"name": "key Ada (01)", "scopes": ["read"], "key_id": "01"}'}
    for server in (shared_pair.scanner, shared_pair.other):
        ask = f"{server.url}/api/v1/session"
        for secret in ("", SECRET[:-1], SECRET + "x"):
            assert httpx.get(ask, headers=said | {"Steradian-Node": secret}, timeout=60).status_code == 401
        seen = httpx.get(ask, headers=said | {"Steradian-Node": SECRET}, timeout=60).json()
        assert (seen["principal"], seen["scopes"]) == ("key Ada (01)", ["read"])
        made = httpx.post(f"{server.url}/api/v1/masks", json={}, headers=said | {"Steradian-Node": SECRET}, timeout=60)
        assert made.status_code == 403, "what they may do is what the first node says"


def test_misrouted_request_is_refused_without_further_forwarding(pair):
    pair.row.of("scanner-1").ensure(simulated=True, address=pair.other.url)
    path = "/scanners/scanner-1/emergency-stop"
    until(lambda: pair.http.post(path).status_code == 202)
    assert pair.http.post(path).json()["emergency_stop"]["laser"] == "unconfirmed"
    released = pair.http.delete(path)
    assert (released.status_code, released.json()["code"]) == (503, "node-unavailable")
    assert "another node's" in released.json()["detail"]


def test_node_secret_mismatch_returns_503_not_401(shared_pair):
    """A page that is told so takes its session for over."""
    stranger = ApiProcess(shared_pair.folder, role="api", node_secret=SECRET[::-1]).wait()
    try:
        released = httpx.delete(f"{stranger.url}/api/v1{STOP}", timeout=250)
    finally:
        stranger.close()
    assert (released.status_code, released.json()["code"]) == (503, "node-unavailable")
    assert "STERADIAN_NODE_SECRET" in released.json()["detail"]


def test_hung_scanner_node_does_not_block_requests_to_other_node(pair):
    with socket.create_server(("127.0.0.1", 0), backlog=100) as deaf, ThreadPoolExecutor(40) as crowd:
        deaf.settimeout(250)
        pair.row.of("scanner-1").ensure(simulated=True, address=f"http://127.0.0.1:{deaf.getsockname()[1]}")

        def ask():
            path = "/scanners/scanner-1/emergency-stop"
            return until(lambda: "is not known" not in (answer := pair.http.delete(path)).text and answer)

        waiting = [crowd.submit(ask) for _ in range(40)]
        taken = [deaf.accept()[0] for _ in range(nodes.AT_ONCE)]  # as many as are sent on at a time
        assert pair.http.delete(STOP).status_code == 200
        assert not any(each.done() for each in waiting), "these wait as before"
        for each in taken:
            each.close()
        deaf.close()
        assert {each.result().status_code for each in waiting} == {503}
