"""Scans over lines that are almost right: the error comes soon, says what is wrong, and a stop is heard meanwhile."""

import pytest
from driver_lines import Line, line, with_crlf, without_flow_control

from fabry_perot.simulator import launch
from steradian.core.exceptions import ScanFailed
from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.scans.acquisition.run import run_scan
from steradian.scans.acquisition.session_control import Command, SessionControl, SessionOutcome, SessionPhase

SOON = 15_000_000
"""Simulator time in µs within which a scan on a bad line has ended; without its limits it took 79 s."""


class StopWhileArming(SessionControl):
    """A stop, wished as soon as the scan is being armed; from then on the line is a bad one."""

    def __init__(self, line: Line) -> None:
        self.line, self.wanted = line, Command.RUN

    def on_phase(self, phase: SessionPhase) -> None:
        if phase is SessionPhase.ARMING:
            self.line.down = with_crlf
            self.wanted = Command.STOP

    def command(self) -> Command:
        return self.wanted


@pytest.fixture
def simulator():
    with launch(speed=1.0) as simulator:
        yield simulator


@pytest.fixture(scope="module")
def plan():
    mask = equi_steradian_mask(aperture=13.56e-3, depth=3.6e-3, count=60)
    return ScanPlan.create(mask=mask, samples=512, pulse_rate=100.0)


@pytest.mark.parametrize(
    ("change", "words"), [(with_crlf, "changes line ends"), (without_flow_control, "software flow control")]
)
def test_scan_on_corrupting_serial_line_fails_soon_with_reason(simulator, plan, tmp_path, change, words):
    before = simulator.send_command("report", fired=False)["time"]
    with line(simulator.url, down=change) as bad, pytest.raises(ScanFailed, match=words) as raised:
        run_scan(plan, bad.url, tmp_path / "a.h5")
    after = simulator.send_command("report", fired=False)
    assert "valid frames" in str(raised.value)
    assert "bytes" in str(raised.value)
    assert after["time"] - before < SOON
    assert (after["shots"], after["shutter"]) == (0, False)


def test_stop_while_arming_on_bad_line_ends_scan_soon(simulator, plan, tmp_path):
    before = simulator.send_command("report", fired=False)["time"]
    with line(simulator.url) as bad:
        summary = run_scan(plan, bad.url, tmp_path / "a.h5", control=StopWhileArming(bad))
    assert summary.end is SessionOutcome.STOPPED
    assert simulator.send_command("report", fired=False)["time"] - before < SOON
