"""Control socket of a port's holder: one line asked, one answered; strangers, floods and crashes change nothing."""

from __future__ import annotations

import json
import os
import signal
import socket
import sys
import threading

import pytest
from driver_holders import FAST, program, report, scan_of

import fabry_perot
from fabry_perot.host import control_client, port_usage
from fabry_perot.host.control_server import ControlServer
from fabry_perot.host.transport import open_transport
from fabry_perot.simulator import launch
from support.waiting import until

pytestmark = pytest.mark.skipif(not control_client.AVAILABLE, reason="Windows has no local sockets in Python")


@pytest.fixture
def simulator():
    with launch() as running:
        yield running


def sockets_of(url):
    return [each for each in control_client.listeners(url) if each.pid == os.getpid()]


def test_port_names_are_equal_for_a_link_and_its_target(simulator):
    assert set(port_usage.aliases(simulator.url)) & set(port_usage.aliases(os.path.realpath(simulator.url)))
    assert port_usage.aliases("socket://LOCALHOST:4001") == port_usage.aliases("socket://127.0.0.1:4001")
    assert port_usage.aliases("socket://127.0.0.1:4001") != port_usage.aliases("socket://127.0.0.1:4002")


def test_a_holder_found_by_the_target_of_a_link_answers_with_its_state(simulator):
    with fabry_perot.connect(simulator.url):
        status = fabry_perot.port_status(os.path.realpath(simulator.url))
        assert (status.state, status.laser, status.shutter) == ("linked", "off", "closed")
        assert (status.interlock, status.key, status.fault) == ("closed", "on", 0)
        assert status.holder.endswith(f"(process {os.getpid()})")
        assert 0 <= status.age < 60
    assert fabry_perot.port_status(simulator.url) is None


WRONG = (b"", b"\n", b"nonsense\n", b"[]\n", b'"stop"\n', b'{"do":7}\n', b'{"do":"fire"}\n', b"[" * 3000 + b"\n")
WORSE = (b'{"do":"stop","seconds":"x"}\n', b"x" * 10_000 + b"\n", b"x" * 10_000, b"\xff\xfe\n")


@pytest.mark.parametrize("line", [*WRONG, *WORSE])
def test_a_malformed_request_is_answered_with_an_error_or_not_at_all_and_the_next_one_is_served(simulator, line):
    with fabry_perot.connect(simulator.url) as scanner:
        (listener,) = sockets_of(simulator.url)
        with socket.socket(socket.AF_UNIX) as client:
            client.settimeout(60)
            client.connect(listener.address)
            try:
                client.sendall(line)
                client.shutdown(socket.SHUT_WR)
                answer = client.recv(65536)
            except OSError:
                answer = b""
        assert answer == b"" or "error" in json.loads(answer)
        assert control_client.ask(listener, 60.0, do="status").body["status"]["state"] == "linked"
        assert scanner.state == "linked"


def test_clients_that_say_nothing_hold_up_no_stop(simulator):
    with fabry_perot.connect(simulator.url):
        (listener,) = sockets_of(simulator.url)
        idle = [socket.socket(socket.AF_UNIX) for _ in range(100)]
        try:
            for each in idle:
                each.connect(listener.address)
            answer = fabry_perot.emergency_stop(simulator.url, timeout=20.0)
            assert answer.laser == "off"
            assert answer.holder.endswith(f"(process {os.getpid()})")
        finally:
            for each in idle:
                each.close()


def test_nothing_remains_of_a_holder_that_was_killed(tmp_path):
    with launch(**FAST) as simulator, scan_of(simulator, tmp_path) as scan:
        assert [each.pid for each in control_client.listeners(simulator.url)] == [scan.pid]
        scan.kill()
        scan.wait()
        assert scan.pid not in [each.pid for each in control_client.listeners(simulator.url)]
        answer = fabry_perot.emergency_stop(simulator.url, timeout=20.0)
        assert answer.laser == "off"
        assert not report(simulator)["shutter"]


def files_of(holder):
    return list(control_client._folder().glob(f"fabry-perot-*-{holder.pid}-*"))


HOLDER = """
    import sys, time
    import fabry_perot
    from fabry_perot.host import control_client
    control_client.ABSTRACT = False
    with fabry_perot.connect(sys.argv[1]) as scanner:
        print("held", flush=True)
        time.sleep(1000)
"""


def test_control_socket_files_of_killed_holder_are_removed(simulator, monkeypatch):
    monkeypatch.setattr(control_client, "ABSTRACT", False)
    with program(HOLDER, simulator.url) as holder:
        assert holder.stdout.readline() == "held\n"
        assert fabry_perot.port_status(simulator.url).state == "linked"
        assert fabry_perot.emergency_stop(simulator.url, timeout=20.0).laser == "off"
        holder.send_signal(signal.SIGKILL)
        holder.wait()
        assert files_of(holder), "its files are still there"
    assert fabry_perot.port_status(simulator.url) is None
    assert files_of(holder) == [], "they were removed"
    with fabry_perot.connect(simulator.url):
        assert fabry_perot.port_status(simulator.url).state == "linked"
    assert control_client.listeners(simulator.url) == []


def test_a_session_does_not_give_its_port_away(simulator):
    with fabry_perot.connect(simulator.url), pytest.raises(fabry_perot.PortBusy, match=f"process {os.getpid()}"):
        fabry_perot.connect(simulator.url)


def test_a_monitor_gives_its_port_to_a_program_that_connects_and_takes_it_back(simulator):
    with fabry_perot.Monitor(simulator.url) as monitor:
        until(lambda: monitor.connection == "connected")
        with fabry_perot.connect(simulator.url) as scanner:
            assert scanner.state == "linked"
            until(lambda: monitor.connection == "busy" and monitor.holder.endswith(f"(process {os.getpid()})"))
        until(lambda: monitor.connection == "connected")
        assert (monitor.holder, monitor.error) == ("", None)


def test_program_that_connects_while_a_monitor_starts_gets_the_port(simulator):
    class Starting:
        """Monitor that has locked the terminal and does not listen for requests yet."""

        def give_way(self):
            line.close()
            return True

    line = open_transport(simulator.url)
    later = threading.Timer(0.4, lambda: servers.append(ControlServer(Starting(), simulator.url)))
    servers = []
    later.start()
    try:
        with fabry_perot.connect(simulator.url) as scanner:
            assert scanner.state == "linked"
    finally:
        later.join()
        servers[0].close()


ASKER = """
    import os, sys
    from fabry_perot.host.emergency_stop import ask_to_yield
    os.setgid(65534)
    os.setgroups([])
    os.setuid(65534)
    print(ask_to_yield(sys.argv[1]))
"""


@pytest.mark.skipif(sys.platform != "linux" or os.geteuid() != 0, reason="only root can become another user")
@pytest.mark.parametrize(("mode", "given"), [(0o600, False), (0o666, True)])
def test_another_user_gets_the_port_of_a_monitor_only_where_it_could_open_it(simulator, mode, given):
    terminal = os.path.realpath(simulator.url)
    os.chmod(terminal, mode)
    with fabry_perot.Monitor(terminal) as monitor:
        until(lambda: monitor.connection == "connected")
        with program(ASKER, terminal) as asker:
            said, errors = asker.communicate(timeout=250)
        assert said == f"{given}\n", errors
        assert (monitor.connection == "busy") is given


def test_a_holder_is_found_under_the_number_that_its_port_has_after_it_was_unplugged():
    with launch(speed=20) as simulator, fabry_perot.connect(simulator.url):
        first = os.path.realpath(simulator.url)
        blocked = os.open(first, os.O_RDWR | os.O_NOCTTY)  # so that the number is not given out again
        simulator.send_command("unplug", seconds=10)
        until(lambda: os.path.exists(simulator.url) and os.path.realpath(simulator.url) != first)
        until(lambda: fabry_perot.port_status(os.path.realpath(simulator.url)) is not None)
        os.close(blocked)


def test_control_socket_rejects_requests_for_reused_port_number():
    with launch(speed=5) as simulator, fabry_perot.connect(simulator.url) as scanner:
        (listener,) = sockets_of(simulator.url)
        number = [name for name in port_usage.aliases(simulator.url) if name.startswith("device")]
        simulator.send_command("unplug", seconds=1000)
        until(lambda: not os.path.exists(simulator.url))
        for do in ("stop", "status", "yield"):
            assert "another port" in control_client.ask(listener, 60.0, do=do, port=number).body["error"]
        assert scanner._session.stopped_by == ""
        assert (
            "error" not in control_client.ask(listener, 60.0, do="status", port=port_usage.aliases(simulator.url)).body
        )
