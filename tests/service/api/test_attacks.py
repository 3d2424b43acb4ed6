"""The table of attacks: each is refused with the right problem, and the service serves afterwards."""

import json
import socket
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta

import httpx
import numpy as np
import pytest

from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from steradian.security.keys import KeyStore, Scope
from steradian.storage.repositories.plans import PlanRepository
from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import ScanState
from support.alines import Aline
from support.processes import resident

from .attacks import ATTACKS, RAW
from .conftest import EQUI, api_of, make_scan

WAIT = 90
EVENTS = b"GET /api/v1/events HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
HALF = b"POST /api/v1/masks HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 999\r\n\r\n{"


class Attacked:
    """An API for the whole table: what is in it, keys of every kind, and a scanner that somebody holds."""

    def __init__(self, folder):
        self.api = api_of(folder, requests_per_second=1e6, failed_keys_per_minute=1e6).wait()
        self.http = httpx.Client(base_url=self.api.url, timeout=WAIT)
        self.v1 = httpx.Client(base_url=f"{self.api.url}/api/v1", timeout=WAIT)
        self.keys, self.things = self._keys(), {}
        self._make_things()
        self.things |= {f"key:{name}": key for name, key in self.keys.items()}
        owner = {"Authorization": f"Bearer {self.keys['owner']}"}
        self.v1.put("/scanners/scanner-0/lease", json={"holder": "alice", "seconds": 600}, headers=owner)

    def _keys(self):
        store = KeyStore(self.api.database)
        past = KeyStore(self.api.database, clock=lambda: datetime.now(UTC) - timedelta(days=2))
        keys = {str(scope): store.create(f"of {scope}", [scope]) for scope in Scope}
        revoked = store.create("revoked", Scope)
        store.revoke(revoked.split("_")[1])
        keys |= {"owner": store.create("owner", Scope), "revoked": revoked}
        keys |= {"expired": past.create("expired", Scope, timedelta(days=1)), "unknown": "sk_000000000000_x"}
        keys |= {"wrong": keys["admin"][:-1] + "#", "malformed": "x" * 5000}
        return keys

    def _make_things(self):
        mask = self.v1.post("/masks", json=EQUI).json()["id"]
        plan = self.v1.post("/plans", json={"mask_id": mask, "samples": 256}).json()["id"]
        scan = make_scan(self.v1, plan, "used-by-another-body").json()["id"]
        over, paused = (make_scan(self.v1, plan).json()["id"] for _ in range(2))
        scans, whole = ScanRepository(self.api.database), PlanRepository(self.api.database).load(plan)
        for state in (ScanState.ARMING, ScanState.RUNNING, ScanState.STOPPING):
            scans.transition(over, state, why="test")
        for state in (ScanState.ARMING, ScanState.RUNNING):
            scans.transition(paused, state, why="test")
        self.v1.put(f"/scans/{paused}/desired-state", json={"state": "paused"})
        for state in (ScanState.PAUSING, ScanState.PAUSED):
            scans.transition(paused, state, why="test")
        create_scan_file(self.api.data.scan_file(over), whole, scan_id=over)
        with ScanFileWriter(self.api.data.scan_file(over)) as store:
            store.append([Aline(0, np.full(whole.samples, 1, np.int16))])
        about = {"points": whole.mask.count, "stored": 1, "fired": 1}
        scans.transition(over, ScanState.PARTIAL, why="test", summary=about)
        wanted = {"scan_id": over, "parameters": {"modes": 8}}
        job = self.v1.post("/reconstructions", json=wanted).json()["id"]
        self.things |= {"mask": mask, "plan": plan, "scan": scan, "over": over, "paused": paused, "job": job}

    def fill(self, value):
        """Put what is there in the place of its names."""
        match value:
            case str():
                for name, thing in self.things.items():
                    value = value.replace(f"{{{name}}}", thing)
                return value
            case dict():
                return {name: self.fill(each) for name, each in value.items()}
        return value

    def ask(self, attack):
        headers = {name: value.encode() for name, value in self.fill(attack.headers).items()}
        if attack.key is not None:
            headers |= {"Authorization": f"Bearer {self.keys[attack.key]}".encode()}
        return self.http.request(attack.method, self.fill(attack.path), headers=headers, **self.fill(attack.more))

    def connect(self, request):
        host, port = self.api.url.removeprefix("http://").split(":")
        connection = socket.create_connection((host, int(port)), timeout=WAIT)
        connection.sendall(request)
        return connection

    def check_it_serves(self):
        assert self.v1.get(f"/masks/{self.things['mask']}").json()["id"] == self.things["mask"]
        assert self.api.process.poll() is None

    def close(self):
        self.http.close()
        self.v1.close()
        self.api.close()


@pytest.fixture(scope="module")
def attacked(tmp_path_factory):
    attacked = Attacked(tmp_path_factory.mktemp("attacked"))
    yield attacked
    attacked.close()
    assert "Traceback" not in attacked.api.log
    for key in attacked.keys.values():
        assert len(key) < 20 or key[-12:] not in attacked.api.log or set(key) == {"x"}, "no secret is in the log"


def test_the_table_has_rows_of_each_kind_and_no_two_of_one_name():
    names = [attack.name for attack in ATTACKS]
    assert len(names) == len(set(names))
    assert len(names) > 700


@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: attack.name)
def test_an_attack_is_refused_with_the_right_problem(attacked, attack):
    answer = attacked.ask(attack)
    assert answer.status_code == attack.status, answer.text[:500]
    assert answer.headers["content-type"] == "application/problem+json", "no page, whatever is asked for"
    assert answer.json()["code"] == attack.code, answer.text[:500]
    assert attack.says is None or [each["pointer"] for each in answer.json()["errors"]] == [attack.says], answer.text
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert "x-evil" not in answer.headers
    attacked.check_it_serves()


@pytest.mark.parametrize("request_of_none", RAW.values(), ids=RAW)
def test_malformed_raw_request_is_rejected_or_closed(attacked, request_of_none):
    with attacked.connect(request_of_none) as connection:
        try:
            answer = connection.recv(65536)
        except ConnectionError:
            answer = b""
    assert not answer or answer.split()[1][:1] == b"4", answer[:200]
    assert answer.count(b"HTTP/1.1 ") <= 1, "what was smuggled is no request"
    attacked.check_it_serves()


def test_a_header_of_the_caller_is_not_sent_back(attacked):
    for name in ("<script>alert(1)</script>", "a b", "x" * 65):
        answer = attacked.v1.get("/masks", headers={"X-Request-ID": name})
        assert answer.headers["x-request-id"] != name


def test_label_with_script_is_returned_as_json_with_nosniff(attacked):
    """Labels are a person's words that others read: they come as JSON, which no browser takes for anything else."""
    script = "<script>alert(1)</script>"
    answer = attacked.v1.patch(f"/scans/{attacked.things['scan']}", json={"labels": {"note": script}})
    assert (answer.status_code, answer.headers["content-type"]) == (200, "application/json")
    assert json.loads(answer.content)["labels"] == {"note": script}
    assert answer.headers["x-content-type-options"] == "nosniff"


@pytest.mark.parametrize(("request_begun", "count"), [(HALF, 100), (EVENTS, 250)], ids=["half bodies", "event streams"])
def test_a_crowd_that_stays_leaves_room_for_others(attacked, request_begun, count):
    with ExitStack() as stack:
        crowd = [stack.enter_context(attacked.connect(request_begun)) for _ in range(count)]
        if request_begun is EVENTS:
            answers = [connection.recv(12) for connection in crowd]
            assert answers.count(b"HTTP/1.1 503") == count - 200, "one too many is told so"
        attacked.check_it_serves()
    attacked.check_it_serves()


def test_all_of_it_took_no_memory_for_good(attacked):
    before = resident(attacked.api.process.pid)
    for attack in ATTACKS[-200:]:
        attacked.ask(attack)
    assert resident(attacked.api.process.pid) - before < 30 * 2**20
