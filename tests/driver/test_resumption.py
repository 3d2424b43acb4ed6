"""The laser comes back by itself only soon after the last contact, from a device that kept power and interlock."""

from __future__ import annotations

import subprocess
import sys

import pytest
from driver_bench import Bench
from driver_world import World

from fabry_perot.errors import LeaseExpired
from fabry_perot.wire.constants import Operation, Type
from fabry_perot.wire.framing import Frame, encode_frame
from fabry_perot.wire.messages import Lease, pack
from fabry_perot.wire.states import DeviceState


def running() -> World:
    world = World(400, ring=100)
    world.begin()
    world.run(60)
    assert world.device.state is DeviceState.SCANNING
    return world


def shots_after(world: World, milliseconds: int = 4_000) -> int:
    """How often the laser fires in the time to come."""
    before = len(world.instrument.log)
    world.run(milliseconds)
    return len(world.instrument.log) - before


def test_a_line_that_comes_back_soon_is_taken_up_and_one_that_comes_back_late_is_not():
    for away, again in ((1_500, True), (4_000, False)):
        world = running()
        world.unplug(away)
        world.run(away)
        assert (shots_after(world) > 0) is again, f"unplugged for {away} ms"


def test_a_device_that_lost_power_does_not_fire_by_itself_however_soon_it_is_back():
    world = running()
    world.reboot(100)
    assert shots_after(world) == 0


def test_an_application_that_hung_for_longer_gets_no_shot_by_itself():
    for hung, again in ((1_500, True), (12_000, False)):
        world = running()
        world.hung = True
        world.run(hung)
        world.hung = False
        assert (shots_after(world) > 0) is again, f"hung for {hung} ms"


def test_a_computer_that_slept_gets_no_shot_by_itself_although_its_clock_stood_still():
    """Where a clock leaves out the time asleep the device's own clock tells."""
    world = running()
    world.asleep = True
    world.run(12_000)
    world.asleep = False
    assert world.host_now < 1_000_000
    assert shots_after(world) == 0


def test_an_application_that_wakes_up_has_its_say_before_the_laser_comes_back():
    """It may have been told to stop meanwhile."""
    world = running()
    world.hung = True
    world.run(1_000)
    world.keeper.poll(world.host_now)
    assert world.keeper.is_recovering
    assert not world.keeper.busy
    world.keeper.poll(world.host_now)
    assert world.keeper.busy


def test_interlock_opened_during_laser_off_prevents_automatic_restart():
    world = running()
    world.hung = True
    world.run(700)
    assert world.device.state is DeviceState.SAFE_HOLD
    world.instrument.closed = False
    world.run(100)
    world.instrument.closed = True
    world.hung = False
    assert shots_after(world) == 0


@pytest.mark.parametrize("meanwhile", ["nothing", "interlock", "reboot", "time"])
def test_a_laser_that_an_application_let_rest_comes_back_without_a_person_only_by_the_same_rule(meanwhile):
    world = running()
    world.keeper.disable()
    world.call(Operation.PAUSE)
    if meanwhile == "interlock":
        world.instrument.closed = False
        world.run(100)
        world.instrument.closed = True
    elif meanwhile == "reboot":
        world.reboot(100)
    world.run(3_000 if meanwhile == "time" else 500)
    world.keeper.resume(world.plan, world.host_now, by_itself=True)
    world.until(lambda: not world.keeper.busy)
    assert (shots_after(world) > 0) is (meanwhile == "nothing")
    assert isinstance(world.keeper.refusal, LeaseExpired) is (meanwhile != "nothing")
    world.finish()  # a person may take it up in any case


def test_an_echo_of_the_future_proves_nothing():
    bench = Bench(ring=5000)
    bench.scan(5000)
    bench.run(100)
    lease = pack(Lease(bench.device.boot, bench.device_now + 100_000_000, 500_000))
    bench.device.receive(encode_frame(Frame(Type.LEASE, 0, 7, bench.host.session, 0, lease)), bench.device_now)
    ended = bench.device_now
    bench.host_alive = False
    for _ in range(100):
        bench.run(30)
        bench.device.receive(encode_frame(Frame(Type.LEASE, 0, 7, bench.host.session, 0, lease)), bench.device_now)
    assert bench.instrument.log[-1][0] < ended + 500_000


def in_another_time(code: str, *, boottime: int) -> str:
    """Run Python where the time asleep is ``boottime`` seconds more."""
    command = ["unshare", "-U", "-r", "-T", "--boottime", str(boottime), sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode and "unshare" in done.stderr:
        pytest.skip(
            f"needs user and time namespaces ({done.stderr.strip()}): Linux 5.6 or newer with sysctl -w"
            " user.max_user_namespaces=1000; in a container also --security-opt seccomp=unconfined"
        )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.skipif(sys.platform != "linux", reason="time namespaces are Linux'")
def test_the_hosts_clock_counts_the_time_a_computer_sleeps():
    asleep, code = 1 << 20, "from fabry_perot.clock import RealClock; print(RealClock().now())"
    here = int(subprocess.check_output([sys.executable, "-c", code]))
    there = int(in_another_time(code, boottime=asleep))
    assert there - here == pytest.approx(asleep * 1e6, abs=60e6)
