"""Clocks: virtual for tests, scaled for the simulator."""

from __future__ import annotations

import pytest
from driver_clock import VirtualClock

from fabry_perot.clock import RealClock, ScaledClock
from fabry_perot.device import DeviceTiming


def test_a_scaled_clock_runs_at_its_rate():
    base = VirtualClock(1_000)
    clock = ScaledClock(20.0, base)
    base.advance(50)
    assert clock.now() == 1_000


def test_a_clock_held_back_goes_on_from_there_and_skips_no_simulated_time():
    base = VirtualClock()
    clock = ScaledClock(2.0, base)
    base.advance(500)
    clock.rewind_to(300)
    assert clock.now() == 300
    base.advance(10)
    assert clock.now() == 320
    clock.rewind_to(9_999)
    assert clock.now() == 320, "holding back never moves it forward"


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan")])
def test_scaled_clock_nonpositive_rate_raises_value_error(rate):
    with pytest.raises(ValueError, match="> 0"):
        ScaledClock(rate)


def test_no_clock_runs_backwards():
    with pytest.raises(ValueError, match="backwards"):
        VirtualClock().advance(-1)
    clock = RealClock()
    assert clock.now() <= clock.now()


def test_device_timing_scaled_keeps_limits_in_host_time():
    timing = DeviceTiming().scaled(20.0)
    assert (timing.status_period, timing.lease_cap) == (2_000_000, 20_000_000)
