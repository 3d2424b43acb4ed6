"""Uploads told apart by a tag, and what an application sees while no A-line comes."""

from contextlib import suppress

import numpy as np
import pytest

import fabry_perot
from fabry_perot.host import WirePlan
from fabry_perot.simulator import launch
from fabry_perot.wire.framing import crc32c

POINTS = np.column_stack([np.linspace(-2e-3, 2e-3, 30), np.zeros(30)])
PARAMETERS = {"samples": 64, "sampling_interval": 8e-9, "pulse_rate": 20.0}


def test_the_same_points_under_another_tag_are_another_plan():
    uids = {WirePlan.from_metres(POINTS, **PARAMETERS, tag=tag).uid for tag in (0, 1, 2)}
    assert len(uids) == 3
    assert WirePlan.from_metres(POINTS, **PARAMETERS).uid in uids


def test_the_identity_of_a_plan_is_worked_out_once_however_often_a_scan_asks_for_it(monkeypatch):
    from fabry_perot.host import plan as module

    sums = []
    monkeypatch.setattr(module, "crc32c", lambda data: sums.append(len(data)) or crc32c(data))
    made = WirePlan.from_metres(POINTS, **PARAMETERS)
    assert len({made.uid for _ in range(100)}) == 1
    assert len(sums) == 1, (
        "the host asks at every A-line; over 1,605 points the sum takes longer than the A-line's rest"
    )


def test_upload_resume_requires_same_tag_and_delivers_held_alines_unfired():
    with launch(speed=10.0, ring=8) as simulator:
        with fabry_perot.connect(simulator.url) as scanner:
            scanner.upload(POINTS, **PARAMETERS, tag=5)
            scanner.start(scanner.arm())
            batches = scanner.alines(idle=True)
            while not (first := next(batches)):
                pass
        with fabry_perot.connect(simulator.url) as scanner:
            with pytest.raises(fabry_perot.PlanInvalid, match="resume"):
                scanner.upload(POINTS, **PARAMETERS, tag=6, resume=True)
        with fabry_perot.connect(simulator.url) as scanner:
            fired = simulator.send_command("report")["shots"]
            scanner.upload(POINTS, **PARAMETERS, tag=5, resume=True)
            held = []
            with suppress(fabry_perot.LeaseExpired, fabry_perot.ScanAborted):
                for batch in scanner.alines(idle=True):
                    held += list(batch)
            assert [line.number for line in held] == list(range(len(held)))
            assert len(held) == fired == simulator.send_command("report")["shots"]
            assert len(held) >= len(first)
            assert not scanner.has_pending_data


@pytest.mark.long
def test_a_pause_leaves_nothing_behind_and_idle_batches_keep_the_application_awake():
    where = np.tile(POINTS, (20, 1))  # more than the device holds: it cannot be done before the host acknowledges
    with launch(speed=10.0) as simulator, fabry_perot.connect(simulator.url) as scanner:
        scanner.upload(where, **PARAMETERS)
        scanner.start(scanner.arm())
        lines = []
        for batch in scanner.alines(idle=True):
            lines += batch
            if len(lines) >= 5 and scanner.state == "scanning":
                scanner.pause()
            if scanner.state == "paused" and not scanner.has_pending_data:
                break
        assert len(lines) == simulator.send_command("report")["shots"]
        assert not scanner.is_recovering
        scanner.acknowledge(lines[-1])
        scanner.resume()
        for batch in scanner.alines():
            lines += batch
            scanner.acknowledge(batch[-1])
        assert [line.number for line in lines] == list(range(len(where)))
