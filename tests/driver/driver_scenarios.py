"""Directed tests: each sets one trap that a deliberate defect must fall into. They run by themselves and on mutants."""

from __future__ import annotations

import random

import driver_faults
from driver_bench import Bench
from driver_world import World

from fabry_perot.errors import RequestRejected
from fabry_perot.host import Host
from fabry_perot.simulator import line_faults
from fabry_perot.wire.constants import AbortLevel, Operation, Type
from fabry_perot.wire.framing import CRC, HEADER, VERSION, Deframer, Frame, crc32c, encode_frame
from fabry_perot.wire.messages import REQUEST_HEAD, Lease, pack
from fabry_perot.wire.states import RUNNING, TRANSITIONS, DeviceState


def stall_released_after_the_hosts_death() -> None:
    world = World(400, ring=300)
    world.begin()
    world.run(40)
    now = world.clock.now()
    world.up.filters.append(line_faults.Delay(now + 100_000, now + 3_000_000))
    world.run(150)
    world.kill_host()
    world.run(4_000)
    shots = len(world.instrument.log)
    assert world.device.state is DeviceState.SAFE_HOLD
    assert shots < 150
    world.finish()
    assert len(world.instrument.log) == 400


def long_stall_with_a_living_host() -> None:
    """Leases given before and during the stall arrive late, and must not add up to a longer one."""
    world = World(400, ring=200)
    world.begin()
    world.run(40)
    now = world.clock.now()
    world.up.filters.append(line_faults.Delay(now, now + 450_000))
    world.run(460)
    world.kill_host()
    world.run(1_500)
    assert world.device.state is DeviceState.SAFE_HOLD


def replay_from_an_earlier_session() -> None:
    world = World()
    world.begin()
    world.run(60)
    old = world.recorder.data
    world.kill_host()
    world.run(700)
    world.new_host()
    before, number = world.device.state, len(world.instrument.log)
    world.up.filters.append(driver_faults.Replay(old, world.clock.now()))
    world.run(300)
    assert world.device.state is before is DeviceState.SAFE_HOLD
    assert len(world.instrument.log) == number
    world.finish()


def requests_of_another_session_or_boot(change: str) -> None:
    bench = Bench()
    bench.connect()
    bench.upload(10)
    session, tag = bench.host.session, 0x07
    if change == "session":
        session = (session - 1) & 0xFFFF
    else:
        tag ^= 1
    for operation in Operation:
        payload = REQUEST_HEAD.pack(900 + operation, operation)
        bench.device.receive(encode_frame(Frame(Type.REQ, 0, tag, session, 0, payload)), bench.device_now)
    assert bench.device.state is DeviceState.READY
    assert not any(bench.device.replies.find(900 + operation) for operation in Operation), "none carried out"


def frames_of_another_session() -> None:
    requests_of_another_session_or_boot("session")


def frames_of_another_boot() -> None:
    requests_of_another_session_or_boot("boot")


def an_old_echo_in_a_new_session() -> None:
    bench = Bench()
    bench.connect()
    bench.upload(10)
    old = bench.host.lease_fields()
    bench.host = Host(nonce=2)
    bench.connect()
    token = bench.call(Operation.ARM)["token"]
    try:
        bench.call(Operation.START, token=token, **old)
    except RequestRejected:
        return
    raise AssertionError("an echo from before the session started the laser")


def reboot_in_mid_plan() -> None:
    world = World()
    world.begin()
    world.run(80)
    world.disk_full = True
    world.run(30)
    world.reboot(200)
    world.disk_full = False
    world.finish()
    ledger = world.keeper.ledger
    assert world.keeper.restarts == 1
    assert len(world.instrument.log) == 40 + len(ledger.refired), "fired = stored + re-fired"
    fired = [index for _, index, _ in world.instrument.log]
    assert sorted(index for index in set(fired) if fired.count(index) == 2) == ledger.refired


def unplugged_and_plugged_in_again() -> None:
    world = World()
    world.begin()
    world.run(60)
    world.unplug(700)
    world.run(100)
    world.finish()
    assert world.keeper.resumes == 1
    assert len(world.instrument.log) == 40, "nothing is fired twice"


def host_killed_and_started_again() -> None:
    world = World()
    world.begin()
    world.run(60)
    world.kill_host()
    world.run(1_000)
    assert world.device.state is DeviceState.SAFE_HOLD
    world.finish()
    assert len(world.instrument.log) == 40


def a_full_disk_fills_the_ring_and_stops_the_laser() -> None:
    world = World()
    world.begin()
    world.run(30)
    world.disk_full = True
    world.run(2_000)
    assert world.device.state is DeviceState.BLOCKED
    shots = len(world.instrument.log)
    assert shots == len(world.disk) + world.device.ring.capacity
    world.finish()
    assert len(world.instrument.log) == 40


def lost_acknowledgements() -> None:
    world = World()
    world.up.filters.append(driver_faults.FramesOfType(Type.ALINE_ACK, lambda count: count % 4 != 3))
    world.begin()
    world.run(600)
    world.finish()
    assert len(world.instrument.log) == 40


def the_last_a_line_is_lost() -> None:
    bench = Bench()
    bench.down.filters.append(driver_faults.FramesOfType(Type.ALINE, lambda count: count == 49))
    bench.scan(50)
    bench.until(lambda: bench.device.state is DeviceState.DONE, 3_000)
    bench.check_exact(50)


def points_are_lost_on_the_way() -> None:
    bench = Bench(max_payload=200)
    bench.up.filters.append(driver_faults.FramesOfType(Type.PLAN_DATA, lambda count: count in (1, 4)))
    bench.connect()
    plan = bench.upload(50)
    assert bench.device.plan.expected == 50
    assert bench.device.plan._points.tobytes() == plan.points.tobytes()


def the_last_points_are_lost() -> None:
    bench = Bench(max_payload=200)
    bench.up.filters.append(driver_faults.FramesOfType(Type.PLAN_DATA, lambda count: count == 4))
    bench.connect()
    bench.upload(50)


def nothing_is_sent_without_credit() -> None:
    bench = Bench()
    bench.scan(100)
    bench.acknowledging = False
    bench.run(120)
    bench.host = Host(nonce=2)
    bench.connect()
    bench.run(200)
    assert bench.device.ring.sent == bench.device.ring.acknowledged, "the new host has granted nothing"


def noise_that_only_a_checksum_finds() -> None:
    source = random.Random(3)
    for _ in range(200):
        data = bytearray(encode_frame(Frame(Type.LEASE, 0, 7, 9, 1, bytes(range(1, 17)))))
        at = source.randrange(4, len(data) - 1)
        data[at] ^= 1 << source.randrange(8)
        assert not Deframer().feed(bytes(data))


def a_length_that_lies_under_a_valid_checksum() -> None:
    from cobs import cobs

    for claimed in (0, 2, 4, 9):
        body = HEADER.pack(VERSION, Type.LEASE, 0, 7, 9, 1, claimed) + b"abc"
        assert not Deframer().feed(b"\0" + cobs.encode(body + CRC.pack(crc32c(body))) + b"\0")


def an_abort_ends_emission_within_its_bound() -> None:
    for level in (AbortLevel.PAUSE, AbortLevel.LASER_OFF, AbortLevel.EMERGENCY_STOP):
        world = World(ring=100)
        world.begin()
        world.run(40)
        world.up.filters.append(driver_faults.FramesOfType(Type.ABORT, lambda count: count < 2))
        asked = world.device_now
        world.abort(level)
        world.run(400)
        assert world.instrument.log[-1][0] < asked + 60_000
        assert not world.host.aborting
        world.finish()


def an_abort_on_a_dead_line_still_ends_emission_by_the_lease() -> None:
    world = World(400, ring=300)
    world.begin()
    world.run(40)
    world.up.filters.append(driver_faults.FramesOfType(Type.ABORT, lambda count: True))
    asked = world.device_now
    world.abort(AbortLevel.LASER_OFF)
    world.run(1_500)
    assert asked < world.instrument.log[-1][0] < asked + 500_000


def every_way_out_of_a_running_scan_closes_the_shutter() -> None:
    exits = [pair for pair, after in TRANSITIONS.items() if pair[0] is DeviceState.SCANNING and after not in RUNNING]
    for _, event in exits:
        bench = Bench()
        bench.scan(500)
        bench.run(60)
        bench.device.transition(event)
        assert not bench.instrument.open_now, f"the shutter is open after {event.name}"


def an_opened_interlock_ends_emission_for_good() -> None:
    bench = Bench()
    bench.scan(500)
    bench.run(60)
    bench.instrument.closed = False
    bench.run(20)
    assert bench.device.state is DeviceState.FAULT
    bench.instrument.closed = True
    shots = len(bench.instrument.log)
    bench.run(500)
    assert len(bench.instrument.log) == shots


def an_arm_token_starts_one_scan_only() -> None:
    bench = Bench()
    bench.connect()
    bench.upload(500)
    token = bench.call(Operation.ARM)["token"]
    bench.call(Operation.START, token=token, **bench.host.lease_fields())
    bench.call(Operation.PAUSE)
    bench.call(Operation.ARM)
    try:
        bench.call(Operation.START, token=token, **bench.host.lease_fields())
    except RequestRejected:
        return
    raise AssertionError("a spent token started the laser")


def an_echo_of_the_future_keeps_no_laser_on() -> None:
    bench = Bench(ring=5000)
    bench.scan(5000)
    bench.run(100)
    ahead = pack(Lease(bench.device.boot, bench.device_now + 100_000_000, 500_000))
    bench.host_alive, ended = False, bench.device_now
    for _ in range(50):
        bench.device.receive(encode_frame(Frame(Type.LEASE, 0, 7, bench.host.session, 0, ahead)), bench.device_now)
        bench.run(30)
    assert bench.instrument.log[-1][0] < ended + 500_000


def a_laser_that_was_off_for_seconds_waits_for_a_person() -> None:
    world = World(400, ring=100)
    world.begin()
    world.run(60)
    world.hung = True
    world.run(4_000)
    world.hung = False
    shots = len(world.instrument.log)
    world.run(1_000)
    assert len(world.instrument.log) == shots


SCENARIOS = {
    function.__name__: function
    for function in (
        frames_of_another_session,
        frames_of_another_boot,
        an_old_echo_in_a_new_session,
        stall_released_after_the_hosts_death,
        long_stall_with_a_living_host,
        replay_from_an_earlier_session,
        reboot_in_mid_plan,
        unplugged_and_plugged_in_again,
        host_killed_and_started_again,
        a_full_disk_fills_the_ring_and_stops_the_laser,
        lost_acknowledgements,
        the_last_a_line_is_lost,
        points_are_lost_on_the_way,
        the_last_points_are_lost,
        nothing_is_sent_without_credit,
        noise_that_only_a_checksum_finds,
        a_length_that_lies_under_a_valid_checksum,
        an_abort_ends_emission_within_its_bound,
        an_abort_on_a_dead_line_still_ends_emission_by_the_lease,
        every_way_out_of_a_running_scan_closes_the_shutter,
        an_opened_interlock_ends_emission_for_good,
        an_arm_token_starts_one_scan_only,
        an_echo_of_the_future_keeps_no_laser_on,
        a_laser_that_was_off_for_seconds_waits_for_a_person,
    )
}
