"""Monitor of a scanner: what it shows is of now, it disturbs no session, and it gives way to a program that scans."""

from __future__ import annotations

import os
import signal
import threading
import time

import pytest
from driver_bench import Bench
from driver_holders import FAST, FOREIGN, program, report, scan_of

import fabry_perot
from fabry_perot.host.sessionless_link import Passive
from fabry_perot.simulator import launch
from fabry_perot.wire.constants import PROTOCOL, Operation, Type
from fabry_perot.wire.framing import Deframer, Frame, encode_frame
from fabry_perot.wire.messages import Hello, HelloAck, pack, unpack
from support.waiting import until


def connected(monitor) -> None:
    until(lambda: monitor.connection == "connected", tell=lambda: f"({monitor.connection}: {monitor.error})")


@pytest.mark.parametrize("line", ["terminal", "tcp"])
def test_a_monitor_of_a_device_that_has_just_booted_shows_its_state(line):
    with (
        launch(tcp="127.0.0.1:0" if line == "tcp" else None) as simulator,
        fabry_perot.Monitor(simulator.url) as monitor,
    ):
        connected(monitor)
        status = monitor.status
        assert (status.state, status.laser, status.shutter) == ("linked", "off", "closed")
        assert (status.interlock, status.key, status.fault, status.holder) == ("closed", "on", 0, "")
        assert (monitor.error, monitor.holder) == (None, "")
        simulator.send_command("interlock", closed=False)
        until(lambda: monitor.status.interlock == "open")
        simulator.send_command("key", on=False)
        until(lambda: monitor.status.key == "off")


def test_monitor_of_device_reporting_status_starts_no_session():
    with launch() as simulator:
        with fabry_perot.connect(simulator.url) as scanner:
            scanner.upload([(0.0, 0.0)] * 5, samples=64, sampling_interval=8e-9, pulse_rate=100.0)
            session = scanner._host.session
        with fabry_perot.Monitor(simulator.url) as monitor:
            connected(monitor)
            assert monitor.status.state == "ready"
            assert monitor.stop("Pat").laser == "off"
        with fabry_perot.connect(simulator.url) as scanner:
            assert scanner._host.session == session % 0xFFFF + 1, "the one after the scanner's own"


def test_monitor_without_new_data_shows_status_age_and_error():
    with launch() as simulator, fabry_perot.Monitor(simulator.url) as monitor:
        connected(monitor)
        assert monitor.status.age < 60
        simulator.send_command("cut", way="down", seconds=1000)
        until(lambda: monitor.connection == "disconnected")
        assert monitor.status.age > 0.9
        assert "received nothing from a scanner" in monitor.error


def test_a_monitor_opens_a_port_again_after_it_was_unplugged():
    with launch(speed=5) as simulator, fabry_perot.Monitor(simulator.url) as monitor:
        connected(monitor)
        simulator.send_command("unplug", seconds=10)
        until(lambda: monitor.connection == "disconnected")
        assert simulator.url in monitor.error
        assert monitor.stop(timeout=0.3).laser == "unconfirmed"
        connected(monitor)
        assert monitor.error is None


def test_a_monitor_of_a_port_that_does_not_exist_waits_for_it(tmp_path):
    port = tmp_path / "port"
    with fabry_perot.Monitor(str(port)) as monitor:
        until(lambda: "o such file" in monitor.error)
        assert (monitor.connection, monitor.status) == ("disconnected", None)
        answer = monitor.stop(timeout=0.5)
        assert answer.laser == "unconfirmed"
        assert answer.detail.endswith("use the hardware switch")
        with launch(link=str(port)):
            connected(monitor)


def test_monitor_of_locked_port_names_holder_process():
    with launch() as simulator, program(FOREIGN, simulator.url) as other:
        assert other.stdout.readline() == "held\n"
        with fabry_perot.Monitor(simulator.url) as monitor:
            until(lambda: monitor.connection == "busy")
            assert f"(process {other.pid})" in monitor.holder
            assert f"(process {other.pid})" in monitor.error
            assert monitor.stop(timeout=20.0).laser == "off"
            other.kill()
            other.wait()
            connected(monitor)


@pytest.mark.parametrize("line", ["terminal", "tcp"])
def test_a_monitor_shows_the_laser_of_a_program_that_scans_and_stops_it(line, tmp_path):
    with (
        launch(**FAST, tcp="127.0.0.1:0" if line == "tcp" else None) as simulator,
        fabry_perot.Monitor(simulator.url) as monitor,
    ):
        connected(monitor)
        with scan_of(simulator, tmp_path) as scan:
            until(lambda: monitor.status.laser == "on")
            assert monitor.connection == "busy"
            assert monitor.holder == monitor.status.holder == f"fabry_perot (process {scan.pid})"
            answer = monitor.stop("Pat", timeout=20.0)
            assert answer.laser == "off"
            # A program that has not answered at once is passed by; over TCP nobody knows its name then.
            assert not answer.holder or f"(process {scan.pid})" in answer.holder
            assert not report(simulator)["shutter"]
            assert "stopped by an emergency stop from Pat" in scan.communicate(timeout=250)[1]
        connected(monitor)
        assert monitor.status.laser == "off"


@pytest.mark.long
def test_a_monitor_that_takes_over_from_a_program_that_was_killed_stops_the_laser(tmp_path):
    with launch(**FAST) as simulator, fabry_perot.Monitor(simulator.url) as monitor:
        connected(monitor)
        with scan_of(simulator, tmp_path) as scan:
            scan.kill()
        answer = monitor.stop(timeout=20.0)
        assert answer.laser == "off"
        assert not report(simulator)["shutter"]


def test_a_monitor_clears_a_fault_once_its_cause_is_gone(tmp_path):
    with launch(**FAST) as simulator:
        with scan_of(simulator, tmp_path) as scan:
            simulator.send_command("interlock", closed=False)
            assert "the interlock was opened" in scan.communicate(timeout=250)[1]
        with fabry_perot.Monitor(simulator.url) as monitor:
            connected(monitor)
            assert (monitor.status.state, monitor.status.fault) == ("fault", 1)
            with pytest.raises(fabry_perot.FaultStands, match="the interlock is open"):
                monitor.clear_fault("Kim")
            simulator.send_command("interlock", closed=True)
            cleared = monitor.clear_fault("Kim")
            assert (cleared.fault.name, cleared.by, cleared.state) == ("interlock-opened", "Kim", "safe_hold")
            with pytest.raises(fabry_perot.RequestRejected):
                monitor.clear_fault("Kim")


def test_a_monitor_that_does_not_hold_the_port_clears_nothing(tmp_path):
    with fabry_perot.Monitor(str(tmp_path / "port")) as monitor, pytest.raises(fabry_perot.ResponseTimeout):
        monitor.clear_fault("Kim")
    with launch() as simulator, program(FOREIGN, simulator.url) as other:
        other.stdout.readline()
        with fabry_perot.Monitor(simulator.url) as monitor:
            until(lambda: monitor.connection == "busy")
            with pytest.raises(fabry_perot.PortBusy, match=str(other.pid)):
                monitor.clear_fault("Kim")


def test_a_monitor_costs_at_most_one_percent_of_a_core():
    with launch() as simulator, fabry_perot.Monitor(simulator.url) as monitor:
        connected(monitor)
        began = time.monotonic()
        clock = time.pthread_getcpuclockid(monitor._thread.ident)
        used = time.clock_gettime(clock)
        threading.Event().wait(3.0)
        share = (time.clock_gettime(clock) - used) / (time.monotonic() - began)
    assert share < 0.01


def test_a_monitor_asked_from_many_threads_answers_all(tmp_path):
    with launch() as simulator, fabry_perot.Monitor(simulator.url) as monitor:
        connected(monitor)
        answers: list = []
        threads = [threading.Thread(target=lambda: answers.append(monitor.stop("Pat", 20.0))) for _ in range(12)]
        for each in threads:
            each.start()
        for each in threads:
            each.join()
    assert [each.laser for each in answers] == ["off"] * 12


def test_a_status_that_waited_in_a_buffer_is_not_shown_as_of_now():
    """What a terminal kept from before it was opened comes at once, a device's STATUS a tenth of a second apart."""
    bench = Bench()
    bench.connect()
    passive = Passive(now=10.0)
    bench.device.poll(bench.device_now + 200_000)
    old = bench.device.next_frames(65536)
    passive.receive(old, 10.001)
    assert passive.status is None
    bench.device.poll(bench.device_now + 400_000)
    passive.receive(bench.device.next_frames(65536), 10.1)
    assert passive.status is not None


def test_monitor_close_while_searching_port_stops_thread(tmp_path):
    monitor = fabry_perot.Monitor(str(tmp_path / "port"))
    monitor.close()
    assert not monitor._thread.is_alive()
    assert repr(monitor).startswith("<Monitor: ")


def test_a_request_to_clear_a_fault_that_was_given_up_is_not_sent_to_a_device_that_comes_back():
    passive = Passive(0.0)
    request = passive.ask(Operation.CLEAR_FAULT)
    passive.pull(0.1)
    passive.withdraw(request)
    (hello,) = Deframer().feed(passive.pull(300.0))
    assert hello.type == Type.HELLO
    nonce = unpack(Hello, hello.payload).nonce
    ack = HelloAck(nonce, 7, 9, PROTOCOL, 1, 12, 1, 641, 512, 10, 1, 0, 0, 0, 0, 0, 0)
    passive.receive(encode_frame(Frame(Type.HELLO_ACK, 0, 7, 9, 1, pack(ack))), 300.1)
    assert Type.REQ not in [frame.type for frame in Deframer().feed(passive.pull(300.2))]


def test_a_stop_on_a_line_that_takes_no_bytes_any_more_is_answered_in_time():
    """A write to a line that is full takes seconds; the one who asked for the stop must not wait for it."""
    with launch() as simulator, fabry_perot.Monitor(simulator.url) as monitor:
        connected(monitor)
        os.kill(simulator.pid, signal.SIGSTOP)
        try:
            answers = [monitor.stop("Pat", timeout=1.5) for _ in range(5)]
        finally:
            os.kill(simulator.pid, signal.SIGCONT)
        assert {answer.laser for answer in answers} == {"unconfirmed"}
        assert max(answer.seconds for answer in answers) < 4.0, "writing to it takes 5 s"
