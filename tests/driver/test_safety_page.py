"""docs/safety.md: the tests it names exist, and its figures follow from the code's limits by its formulas."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from fabry_perot.device import DeviceTiming
from fabry_perot.host import HostTiming, RecoveryPolicy

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "safety.md").read_text()
NAMED = sorted(set(re.findall(r"`(test_\w+\.py)::(\w+)`", PAGE)))


def test_the_page_names_tests():
    assert len(NAMED) > 25


@pytest.mark.parametrize(("file", "name"), NAMED)
def test_a_named_test_exists_in_one_file(file, name):
    found = [path for path in (ROOT / "tests").rglob(file) if f"\ndef {name}(" in path.read_text()]
    assert len(found) == 1


def test_safety_page_measure_rows_each_name_a_test():
    for title in (
        "Measures in firmware and driver",
        "Automatic restart of the laser",
        "Longest emission after a failure",
    ):
        section = PAGE.split(f"## {title}\n")[1].split("\n## ")[0]
        rows = [line for line in section.splitlines() if line.startswith("| ") and "shown by" not in line]
        assert rows
        for row in rows:
            assert re.search(r"`test_\w+\.py::\w+`|the hardware's own test", row), row


def test_safety_page_figures_equal_formula_results():
    host, device = HostTiming(), DeviceTiming()
    ttl, cap, shutter, period = (µs * 1e-6 for µs in (host.ttl, device.lease_cap, device.shutter, host.abort_period))
    line, turn, watchdog, lost = 0.005, 0.01, 0.1, 2
    figures = {
        "min(TTL, cap) + s": min(ttl, cap) + shutter,
        "cap + s": cap + shutter,
        "min(d + p + k·r, TTL) + s": min(line + turn + lost * period, ttl) + shutter,
        "d + p + s": line + turn + shutter,
        "p + s": turn + shutter,
        "w + s, by the watchdog": watchdog + shutter,
        "s, by the shutter's spring": shutter,
    }
    rows = re.findall(r"^\| [^|]+ \| ([^|]+) \| ([0-9.]+) s[^|]* \|", PAGE, re.MULTILINE)
    assert {formula for formula, _ in rows} == set(figures)
    for formula, figure in rows:
        assert float(figure) == pytest.approx(figures[formula]), formula
    for words, value in (
        ("*TTL*: requested lease (500 ms)", ttl),
        ("device grants (1 s)", cap),
        ("(50 ms)", shutter),
    ):
        assert words in PAGE, value
    assert f"within {RecoveryPolicy().within:g} s of the last contact" in PAGE
