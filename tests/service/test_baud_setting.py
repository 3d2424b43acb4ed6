"""Baud rates in the service's setting and in ``steradian scan``."""

import subprocess
from contextlib import suppress

import pytest
from driver_lines import stranger
from typer.testing import CliRunner

from steradian.cli.app import app
from steradian.cli.scanner_port import at_baud
from steradian.core.exceptions import InvalidInput, ScanFailed
from steradian.core.settings import Settings
from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.plans.files import write_json
from steradian.plans.scanner_model import Link


def plan_with(link):
    return ScanPlan.create(mask=equi_steradian_mask(aperture=13.56e-3, depth=3.6e-3, count=20), link=link)


SLOW, USB, FREE = plan_with(Link.serial(921_600)), plan_with(Link.create()), plan_with(Link.create(byte_rate=None))


@pytest.mark.parametrize(
    ("scanner", "baud", "plan", "expected"),
    [
        ("/dev/ttyUSB0", None, SLOW, "/dev/ttyUSB0?baud=921600"),
        ("/dev/ttyUSB0", 460_800, SLOW, "/dev/ttyUSB0?baud=460800"),
        ("/dev/ttyUSB0?baud=115200", None, SLOW, "/dev/ttyUSB0?baud=115200"),
        ("/dev/ttyUSB0", None, USB, "/dev/ttyUSB0"),
        ("/dev/ttyUSB0", None, FREE, "/dev/ttyUSB0"),
        ("/dev/ttyUSB0", None, None, "/dev/ttyUSB0"),
        ("socket://lab:4001", None, SLOW, "socket://lab:4001"),
        ("rfc2217://lab:4001", 921_600, None, "rfc2217://lab:4001?baud=921600"),
        ("simulated", None, SLOW, "simulated"),
    ],
)
def test_at_baud_of_a_port_is_the_option_then_the_ports_own_then_the_plans(scanner, baud, plan, expected):
    assert at_baud(scanner, baud, plan) == expected


@pytest.mark.parametrize(("scanner", "baud"), [("/dev/ttyUSB0", 7), ("/dev/ttyUSB0", 10**9), ("simulated", 921_600)])
def test_at_baud_with_invalid_rate_or_simulated_scanner_is_refused(scanner, baud):
    with pytest.raises(InvalidInput, match=rf"baud is {baud}; allowed"):
        at_baud(scanner, baud)


def test_scan_run_opens_the_port_at_the_plans_baud_rate(tmp_path):
    write_json(SLOW, tmp_path / "plan.json")
    with stranger() as url:
        seen = []

        class Watch:
            def __init__(self, *_, **__):
                said = subprocess.run(["stty", "-F", url], capture_output=True, text=True, check=True).stdout
                seen.append(said.split(";")[0])
                raise ScanFailed("seen")

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("fabry_perot.host.discovery.Scanner", Watch)
            with suppress(ScanFailed):
                words = ["scan", "run", tmp_path / "plan.json", "--scanner", url, "-o", tmp_path / "s.h5"]
                CliRunner().invoke(app, [str(word) for word in words])
    assert seen == ["speed 921600 baud"]


def test_settings_with_an_impossible_baud_rate_are_refused(tmp_path):
    assert Settings.create(data=tmp_path, scanner="/dev/ttyUSB0?baud=921600").scanner.endswith("?baud=921600")
    with pytest.raises(InvalidInput, match=r"scanner is /dev/ttyUSB0\?baud=7; allowed: .*1,200 … 20,000,000 Bd"):
        Settings.create(data=tmp_path, scanner="/dev/ttyUSB0?baud=7")
