"""The conformance scenarios: the device passes, each deliberately broken one fails the scenario made for it."""

from __future__ import annotations

import re
import subprocess
import sys
from xml.etree import ElementTree

import pytest
from driver_bench import CAPABILITIES
from driver_line import VirtualLine, outcomes
from driver_mutants import MUTANTS

from fabry_perot.conformance import SCENARIOS, ConformanceHost, as_junit, run
from fabry_perot.device import device_state, request_handlers
from fabry_perot.errors import PlanInvalid
from fabry_perot.simulator import launch
from fabry_perot.wire.constants import Operation, Result, Type
from fabry_perot.wire.framing import Deframer
from fabry_perot.wire.states import RUNNING, Event, HoldCause

NAMES = [scenario.run.__name__ for scenario in SCENARIOS]
KILLERS = {
    "no CRC check": "checksum",
    "no length check": "length",
    "ring overwrites": "full_ring",
    "plan gaps accepted": "plan_gaps",
    "session not checked": "session",
    "boot id not checked": "stale_boot_frames",
    "lease kept over a new session": "earlier_session",
    "lease by arrival time": "stale_echo",
    "no credit check": "credit",
    "shutter left open": "lease_expiry",
    "interlock not watched": "interlock",
    "token used again": "arm_token",
    "echoes of the future": "future_echo",
}
OF_THE_HOST = {"no tail-loss repair", "no plan time-out", "abort not repeated", "laser comes back at any time"}


@pytest.mark.parametrize("limits", [{}, {"max_payload": 64, "plan_points": 8, "ring": 12}], ids=["usual", "small"])
def test_the_device_passes_every_scenario(limits):
    assert outcomes(**limits) == dict.fromkeys(NAMES, "")


@pytest.mark.parametrize("speed", [20, 200])
def test_conformance_scan_scenarios_pass_on_accelerated_device_clock(speed, monkeypatch):
    monkeypatch.setitem(CAPABILITIES, "clock_rate", float(speed))
    wanted = ("credit", "lease_expiry", "stale_echo", "future_echo", "new_session", "abort_levels")
    assert outcomes(*wanted, speed=speed) == dict.fromkeys(wanted, "")


def test_conformance_waits_for_simulated_clock_slower_than_declared(monkeypatch):
    monkeypatch.setitem(CAPABILITIES, "clock_rate", 20.0)
    wanted = ("lease_expiry", "stale_echo")
    assert outcomes(*wanted, speed=20, pace=6) == dict.fromkeys(wanted, "")


class LateHello(VirtualLine):
    """Line that delivers HELLO of a new session only after the lease has expired, a number of times."""

    def __init__(self, delays):
        super().__init__(ring=16)
        self.delays, self._late, self._reads = delays, b"", 0

    def write(self, data):
        is_firing = self.device.state in RUNNING
        if not self._late and is_firing and self.delays and Deframer().feed(data)[0].type == Type.HELLO:
            self.delays, self._reads = self.delays - 1, 600
        if self._reads:
            self._late += data
        else:
            super().write(data)

    def read(self):
        self._reads = max(0, self._reads - 1)
        if not self._reads:
            super().write(self._late)
            self._late = b""
        return super().read()


def failure_of_new_session(line):
    """Run the scenario of a new session and return its failure, empty when it passes."""
    (outcome,) = run(ConformanceHost(line, line.clock), fire=True, only=["new_session"])
    return outcome.failure


@pytest.mark.parametrize("delays", [1, 3])
def test_conformance_repeats_new_session_after_lease_expiry_on_slow_line(delays):
    line = LateHello(delays)
    assert failure_of_new_session(line) == ""
    assert line.delays == 0


def test_conformance_fails_if_every_lease_expires_before_new_session():
    assert failure_of_new_session(LateHello(100)).startswith("expected: hold cause 2")


@pytest.mark.parametrize("delays", [0, 1])
def test_conformance_fails_device_with_wrong_hold_cause_of_new_session(delays, monkeypatch):
    monkeypatch.setitem(device_state._CAUSES, Event.NEW_SESSION, HoldCause.LEASE)
    assert failure_of_new_session(LateHello(delays)).startswith("expected: hold cause 2")


@pytest.mark.long
@pytest.mark.parametrize("speed", [20, 200])
def test_conformance_of_a_simulator_that_runs_faster_passes_every_scenario(speed):
    command = [sys.executable, "-m", "fabry_perot", "conformance"]
    with launch(speed=speed) as simulator:
        done = subprocess.run([*command, simulator.url], capture_output=True, text=True, timeout=550)
    assert re.search(r"^\d+ passed, 0 failed, 2 skipped$", done.stdout, re.MULTILINE), done.stdout + done.stderr


def test_every_mutant_of_the_protocol_is_one_of_the_device_or_of_the_host():
    assert set(KILLERS) | OF_THE_HOST == set(MUTANTS)
    assert set(KILLERS.values()) <= set(NAMES)


@pytest.mark.mutants
@pytest.mark.parametrize("name", KILLERS)
def test_a_mutant_fails_the_scenario_made_for_it(name, monkeypatch):
    MUTANTS[name].apply(monkeypatch)
    assert outcomes(KILLERS[name])[KILLERS[name]].startswith("expected: ")


def test_conformance_real_hardware_skips_firing_and_interactive_by_default(monkeypatch):
    monkeypatch.setitem(CAPABILITIES, "simulated", False)
    line = VirtualLine(ring=16)
    found = run(ConformanceHost(line, line.clock))
    assert "open" not in line.instrument.shutter
    assert {each.name for each in found if each.skipped} == {
        scenario.run.__name__ for scenario in SCENARIOS if scenario.fires or scenario.asks
    }
    assert not any(each.failure for each in found)


@pytest.mark.parametrize("name", ["lease kept over a new session", "lease by arrival time", "echoes of the future"])
def test_conformance_mutant_firmware_never_fires_real_hardware_by_default(name, monkeypatch):
    MUTANTS[name].apply(monkeypatch)
    monkeypatch.setitem(CAPABILITIES, "simulated", False)
    line = VirtualLine(ring=16)
    run(ConformanceHost(line, line.clock))
    assert "open" not in line.instrument.shutter


def test_a_silent_line_fails_every_scenario_and_ends():
    class Silent(VirtualLine):
        def read(self) -> bytes:
            self.clock.advance(20_000)
            return b""

    line = Silent()
    found = run(ConformanceHost(line, line.clock), only=["hello_nonce", "credit"])
    assert [each.failure for each in found] == ["HELLO of version 2 is not answered"] * 2


def test_conformance_with_unknown_name_is_refused_and_names_the_known_ones():
    with pytest.raises(PlanInvalid, match=r"only is hello_nonse; allowed: .*hello_nonce"):
        run(None, only=["credit", "hello_nonse"])


@pytest.mark.long
def test_conformance_command_prints_table_writes_junit_and_sets_exit_code(tmp_path):
    command = [sys.executable, "-m", "fabry_perot", "conformance"]
    with launch(ring=32) as simulator:
        good = subprocess.run(
            [
                *command,
                simulator.url,
                "--junit",
                str(tmp_path / "good.xml"),
                "--only",
                "hello_nonce",
                "arm_token",
                "reboot",
            ],
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
    assert good.returncode == 0, good.stdout + good.stderr
    assert re.findall(r"(?m)^(ok|FAILED|skipped) +\w+ +(\w+)", good.stdout) == [
        ("ok", "arm_token"),
        ("skipped", "reboot"),
        ("ok", "hello_nonce"),
    ]
    assert good.stdout.endswith("2 passed, 0 failed, 1 skipped\n")
    suite = ElementTree.parse(tmp_path / "good.xml").getroot()  # noqa: S314
    assert {case.get("name"): [child.tag for child in case] for case in suite} == {
        "arm_token": [],
        "reboot": ["skipped"],
        "hello_nonce": [],
    }


def test_conformance_junit_failure_contains_expected_behaviour(monkeypatch):
    MUTANTS["token used again"].apply(monkeypatch)
    line = VirtualLine(ring=16)
    report = as_junit(run(ConformanceHost(line, line.clock), fire=True, only=["arm_token"]), "here")
    suite = ElementTree.fromstring(report)  # noqa: S314
    assert suite.get("failures") == "1"
    assert suite.find("testcase/failure").get("message") == "expected: another token for another ARM"


def test_conformance_incomplete_response_fails_only_its_scenario(monkeypatch):
    """ARM without a token is the device's failing; the scenarios behind it are tried all the same."""
    monkeypatch.setitem(request_handlers._TABLE, Operation.ARM, lambda device, body: (Result.OK, {}))
    found = outcomes("arm_token", "plan_gaps", "hello_nonce")
    assert "token" in found["arm_token"]
    assert (found["plan_gaps"], found["hello_nonce"]) == ("", "")
