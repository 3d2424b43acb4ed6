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
from fabry_perot.device import request_handlers
from fabry_perot.errors import PlanInvalid
from fabry_perot.simulator import launch
from fabry_perot.wire.constants import Operation, Result

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
