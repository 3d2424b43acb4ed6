"""Fixtures of the driver's tests, and which of them run by default."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

import driver_faults
from driver_bench import Bench

from fabry_perot.simulator import line_faults as line_faults


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture
def make_bench() -> type[Bench]:
    return Bench


class Faults:
    """The filters, reachable from tests by one fixture."""

    bit_flips, byte_loss, drop = line_faults.BitFlips, driver_faults.ByteFaults, driver_faults.FramesOfType
    stall, recorder = line_faults.Delay, driver_faults.Recorder


@pytest.fixture
def faults() -> type[Faults]:
    return Faults
