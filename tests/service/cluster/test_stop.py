"""The emergency stop of a service that is several nodes: pressed on any, with the database gone, heard by the laser."""

import os
import signal
import uuid
from contextlib import ExitStack

import pytest

from fabry_perot.simulator import launch
from support.cluster import Cluster
from support.waiting import until

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]
STOP = "/scanners/{}/emergency-stop"
NAMES = ("scanner-0", "scanner-1")


@pytest.fixture(scope="module")
def lasers():
    """Two simulated scanners, which tell by their own clocks when they fired."""
    with ExitStack() as stack:
        yield {name: stack.enter_context(launch(tcp="127.0.0.1:0")) for name in NAMES}


@pytest.fixture(scope="module")
def cluster(tmp_path_factory, postgres, seaweed, lasers):
    scanners = {name: laser.url for name, laser in lasers.items()}
    with Cluster(tmp_path_factory.mktemp("cluster"), postgres, seaweed, scanners) as cluster:
        yield cluster


@pytest.fixture
def fire(cluster, lasers):
    """Begin a scan of minutes on a scanner; returns its identifier once the laser fires. All is released at the end."""

    def fire(name):
        shots = lasers[name].send_command("report")["shots"]
        plan = cluster.first.plan(1600, pulse_rate=10)
        body, key = {"plan_id": plan, "scanner_id": name}, {"Idempotency-Key": uuid.uuid4().hex}
        answer = cluster.first.http.post("/scans", json=body, headers=key)
        assert answer.status_code == 201, answer.text
        until(lambda: lasers[name].send_command("report")["shots"] > shots + 2)
        return answer.json()["id"]

    yield fire
    for name in NAMES:
        scans = cluster.first.get("/scans", params={"state": ["running", "arming", "queued"]}).json()["items"]
        for scan in scans:
            cluster.first.http.put(f"/scans/{scan['id']}/desired-state", json={"state": "aborted"})
        cluster.first.http.delete(STOP.format(name)).raise_for_status()
    until(lambda: not cluster.first.get("/scans", params={"state": ["running", "aborting"]}).json()["items"])


def assert_dark(laser, after):
    """No shot since the answer, and none for as long as fifteen pulses would take."""
    until(lambda: laser.send_command("report")["time"] > after["time"] + 1_500_000)
    later = laser.send_command("report")
    assert (later["shots"], later["last_shot"]) == (after["shots"], after["last_shot"])


def press(node, name):
    """Press the stop until the scanner's own confirmation comes with the answer; a busy machine is late with it."""
    answers = []

    def confirmed():
        answers.append(node.http.post(STOP.format(name), json={"reason": "smoke"}))
        assert answers[-1].status_code == 202, answers[-1].text
        return answers[-1].json()["emergency_stop"]["laser"] in {"off", "idle"}

    until(confirmed)
    return answers[-1].json()["emergency_stop"]


@pytest.mark.parametrize("which", ["first", "second"])
def test_a_stop_from_each_node_needs_no_database(cluster, lasers, fire, postgres, which):
    node, laser = getattr(cluster, which), lasers["scanner-0"]
    scan = fire("scanner-0")
    postgres.kill()
    try:
        assert node.http.get("/scans").status_code == 503
        stop = press(node, "scanner-0")
        after = laser.send_command("report")
        assert (stop["by"], stop["recorded"]) == ("local", False)
        assert_dark(laser, after)
    finally:
        postgres.start()
    other = cluster.second if node is cluster.first else cluster.first
    until(lambda: (seen := other.http.get("/scanners/scanner-0")).is_success and seen.json()["emergency_stop"])
    until(lambda: other.get("/scanners/scanner-0").json()["emergency_stop"]["laser"] == stop["laser"])
    shown = other.get("/scanners/scanner-0").json()["emergency_stop"]
    assert (shown["number"], shown["reason"], shown["recorded"]) == (stop["number"], "smoke", True)
    until(lambda: other.get(f"/scans/{scan}").json()["state"] in {"aborted", "interrupted"})
    refused = other.http.post("/scans", json={"plan_id": other.plan(60)}, headers={"Idempotency-Key": f"{which}-1"})
    assert (refused.status_code, refused.json()["code"]) == (422, "invalid-input"), "which scanner?"
    plan = {"plan_id": other.plan(60), "scanner_id": "scanner-0"}
    refused = other.http.post("/scans", json=plan, headers={"Idempotency-Key": f"{which}-2"})
    assert (refused.status_code, refused.json()["code"]) == (409, "emergency-stopped")
    released = other.http.delete(STOP.format("scanner-0"), params={"number": stop["number"]})
    assert released.is_success, released.text
    assert released.json()["emergency_stop"] is None


def test_a_stop_of_one_scanner_leaves_the_other_firing(cluster, lasers, fire):
    stopped, going = fire("scanner-0"), fire("scanner-1")
    press(cluster.second, "scanner-0")
    after = lasers["scanner-0"].send_command("report")
    before = lasers["scanner-1"].send_command("report")["shots"]
    assert_dark(lasers["scanner-0"], after)
    until(lambda: lasers["scanner-1"].send_command("report")["shots"] > before + 5)
    until(lambda: cluster.first.get(f"/scans/{stopped}").json()["state"] == "aborted")
    assert cluster.first.get(f"/scans/{going}").json()["state"] == "running"
    assert cluster.first.http.post(STOP.format("scanner-9")).status_code == 404


def test_stop_reaches_laser_through_database_while_node_api_hangs(cluster, lasers, fire):
    scan, node = fire("scanner-1"), cluster.scanners["scanner-1"]
    api = node.pid_of("api")
    os.kill(api, signal.SIGSTOP)
    try:
        answer = cluster.first.http.post(STOP.format("scanner-1"), json={"reason": "smoke"})
        assert answer.status_code == 202, answer.text
        assert answer.json()["emergency_stop"]["laser"] == "unconfirmed"
        until(lambda: cluster.second.get(f"/scans/{scan}").json()["state"] == "aborted")
        assert_dark(lasers["scanner-1"], lasers["scanner-1"].send_command("report"))
        assert cluster.second.get("/scanners/scanner-1").json()["emergency_stop"]["reason"] == "smoke"
    finally:
        os.kill(api, signal.SIGCONT)
    until(lambda: cluster.second.get("/scanners/scanner-1").json()["emergency_stop"]["laser"] != "unconfirmed")


def test_a_scanner_is_retired_when_its_node_is_gone_and_comes_back_with_it(cluster, lasers):
    """Neither while that answers, nor while it holds its lock and does not answer."""
    node, here = cluster.scanners["scanner-1"], "/scanners/scanner-1"
    refused = cluster.first.http.delete(here)
    assert (refused.status_code, refused.json()["code"]) == (409, "in-use")
    api = node.pid_of("api")
    os.kill(api, signal.SIGSTOP)
    try:
        refused = cluster.first.http.delete(here)
        assert (refused.status_code, refused.json()["code"]) == (409, "in-use"), "its lock says that it lives"
    finally:
        os.kill(api, signal.SIGCONT)
    node.kill()
    try:
        pressed = cluster.second.http.post("/emergency-stop").json()["items"]
        assert {one["id"]: one["emergency_stop"]["laser"] for one in pressed}["scanner-1"] == "unconfirmed"
        until(lambda: cluster.first.http.delete(here).status_code == 204)  # the server has noticed that it is gone
        for each in (cluster.first, cluster.second):
            names = [one["id"] for one in each.get("/scanners").json()["items"]]
            assert names == ["scanner-0"]
            until(lambda each=each: each.http.post(STOP.format("scanner-1")).status_code == 404)
    finally:
        node.start()
    until(lambda: cluster.first.http.get(here).is_success)
    assert cluster.first.get(here).json()["emergency_stop"] is not None, "what was pressed stands"
    for name in NAMES:
        until(lambda name=name: cluster.first.http.delete(STOP.format(name)).is_success)
