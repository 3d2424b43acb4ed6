"""``fabry-perot status`` and the counters of a scanner with a latched fault or emergency stop."""

from __future__ import annotations

import json
import sys

import pytest
from driver_bench import Bench

import fabry_perot
from fabry_perot.device.request_handlers import LONGEST_TEXT
from fabry_perot.errors import DeviceFault
from fabry_perot.hardware import InstrumentError
from fabry_perot.simulator import launch
from fabry_perot.wire.constants import Operation
from fabry_perot.wire.states import DeviceState
from support import copies


def status(url: str) -> dict:
    command = [sys.executable, "-m", "fabry_perot", "status", "--json", url]
    done = copies.run(command)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.long
def test_status_of_a_scanner_in_fault_and_in_emergency_stop_names_them():
    with launch() as simulator:
        with fabry_perot.connect(simulator.url) as scanner:
            scanner.upload([(0.0, 0.0)] * 500, samples=64, sampling_interval=8e-9, pulse_rate=100.0)
            scanner.arm()
            simulator.send_command("interlock", closed=False)
            scanner._session.wait(lambda: scanner.state == "fault", 60.0)
        figures = status(simulator.url)
        assert (figures["state"], figures["fault"], figures["fault_name"]) == ("fault", 1, "interlock-opened")
        with fabry_perot.connect(simulator.url) as scanner:
            scanner.abort("emergency-stop")
        assert status(simulator.url)["state"] == "estop"


def test_get_in_hardware_fault_returns_state_and_fault_text(monkeypatch):
    bench = Bench()
    bench.connect()
    words = "the laser TCPIP::127.0.0.1::5025::SOCKET was lost" + 200 * "!"

    def lost() -> dict[str, int]:
        raise InstrumentError(5, words)

    monkeypatch.setattr(bench.instrument, "parameters", lost)
    with pytest.raises(fabry_perot.RequestRejected, match="hardware-fault"):
        bench.call(Operation.GET)
    answer = bench.call(Operation.GET)
    assert (answer["state"], answer["fault"]) == (DeviceState.FAULT, 5)
    assert answer["fault_text"] == words[:LONGEST_TEXT]


def test_device_fault_has_the_text_of_the_device_in_its_message_and_survives_pickling():
    import pickle

    fault = pickle.loads(pickle.dumps(DeviceFault(5, "/dev/ttyUSB0", "laser off")))  # noqa: S301
    assert (fault.fault, fault.port, fault.text) == (5, "/dev/ttyUSB0", "laser off")
    assert "(scanner: laser off)" in str(fault)
