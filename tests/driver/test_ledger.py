"""The account of shots over reboots, by itself."""

from __future__ import annotations

import numpy as np
import pytest

from fabry_perot.host.plan import WirePlan
from fabry_perot.host.shot_accounting import ScanReport, ShotLedger
from fabry_perot.wire.messages import POINT


def plan(count: int, averages: int) -> WirePlan:
    records = np.zeros(count, POINT)
    records["averages"] = averages
    return WirePlan(records, 64, 8000, 50_000)


def test_shots_lost_with_a_reboot_are_named_once_however_often_the_recovery_has_to_start_over():
    ledger = ShotLedger()
    ledger.record_start(boot=1, start=0, laser_shots=1000, wasted=0)
    for _ in range(3):
        ledger.record_reboot(plan(50, 1), 2, kept=12, laser_shots=1020, wasted=0)
    assert ledger.refired == list(range(12, 20))
    assert ledger.wasted(0) == 0


def test_an_average_that_a_reboot_cut_short_counts_as_wasted_not_as_an_a_line():
    ledger = ShotLedger()
    ledger.record_start(boot=1, start=0, laser_shots=0, wasted=5)
    ledger.record_reboot(
        plan(50, 10), 2, kept=2, laser_shots=47, wasted=8
    )  # 3 discarded before, 4 whole averages, 4 shots of a fifth
    assert ledger.refired == [2, 3]
    ledger.record_start(boot=2, start=2, laser_shots=47, wasted=0)
    assert ledger.wasted(1) == 3 + 4 + 1


def test_two_reboots_add_up():
    ledger = ShotLedger()
    ledger.record_start(boot=1, start=0, laser_shots=0, wasted=0)
    ledger.record_reboot(plan(50, 1), 2, kept=5, laser_shots=8, wasted=0)
    ledger.record_start(boot=2, start=5, laser_shots=8, wasted=0)
    ledger.record_start(boot=2, start=9, laser_shots=12, wasted=0)  # a resume in the same boot
    ledger.record_reboot(plan(50, 1), 3, kept=9, laser_shots=14, wasted=0)
    assert ledger.refired == [5, 6, 7, 9, 10]
    assert ledger.first == 0


def test_a_second_reboot_before_anything_is_fired_again_names_nothing_more():
    ledger = ShotLedger()
    ledger.record_start(boot=1, start=0, laser_shots=0, wasted=0)
    ledger.record_reboot(plan(50, 2), 2, kept=5, laser_shots=24, wasted=8)  # 4 discarded averages, 8 whole ones
    ledger.record_reboot(plan(50, 2), 3, kept=5, laser_shots=24, wasted=0)
    assert ledger.refired == [5, 6, 7]


def test_ledger_counts_shots_after_start_with_lost_response():
    ledger = ShotLedger()
    ledger.record_start(boot=1, start=0, laser_shots=0, wasted=0)
    ledger.record_reboot(plan(50, 1), 2, kept=5, laser_shots=8, wasted=0)
    ledger.record_start(
        boot=2, start=5, laser_shots=10, wasted=0
    )  # not the first in this boot: that one fired two points
    ledger.record_reboot(plan(50, 1), 3, kept=5, laser_shots=12, wasted=0)
    assert ledger.refired == [5, 6, 7, 5, 6, 7, 8]


@pytest.mark.parametrize(("stored", "balanced"), [(10, True), (9, False), (11, False)])
def test_scan_report_balance_detects_unaccounted_shots(stored, balanced):
    report = ScanReport(20, 27, stored, 1, (3, 4), 2, 1, 0, 1, 0, 0, 0)
    assert report.is_balanced is balanced
