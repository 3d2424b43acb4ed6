"""The laser goes off when it must and on only when somebody asked, under a virtual clock."""

from __future__ import annotations

import pickle

import pytest

from fabry_perot.errors import DeviceRestarted, PlanInvalid, RequestRejected
from fabry_perot.hardware.instrument import InstrumentError
from fabry_perot.host import Host
from fabry_perot.wire.constants import AbortLevel, Operation, Type
from fabry_perot.wire.framing import Frame, encode_frame
from fabry_perot.wire.messages import REQUEST_HEAD, Lease, pack
from fabry_perot.wire.states import DeviceState

TTL = 500_000


def test_a_killed_host_means_laser_off_within_the_ttl_of_device_time(bench):
    bench.scan(5000)
    bench.run(700)
    died = bench.device_now
    bench.host_alive = False
    bench.run(3000)
    assert bench.device.state is DeviceState.SAFE_HOLD
    assert died - 10_000 < bench.instrument.log[-1][0] < died + TTL
    assert bench.device.status().last_shot < bench.device.status().lease_until <= died + TTL


def test_bytes_stuck_in_a_buffer_cannot_fire_the_laser_after_the_hosts_death(bench, faults):
    bench.scan(5000)
    bench.run(300)
    now = bench.clock.now()
    bench.up.filters.append(faults.stall(now, now + 2_500_000))
    bench.run(450)
    bench.host_alive = False
    bench.run(1500)
    shots = len(bench.instrument.log)
    bench.run(2000)
    assert bench.up.filters[-1].held == b"", "the stalled leases were released"
    assert len(bench.instrument.log) == shots
    assert bench.device.state is DeviceState.SAFE_HOLD


def test_a_hung_consumer_drops_the_laser_although_the_link_stays_alive(bench):
    bench.scan(5000)
    bench.run(300)
    hung = bench.device_now
    bench.consuming = False
    bench.run(1500)
    assert bench.device.state is DeviceState.SAFE_HOLD
    assert bench.instrument.log[-1][0] < hung + TTL
    assert bench.host.time_since_heard(bench.clock.now()) < 200_000


def test_expired_lease_keeps_data_and_explicit_resume_completes_scan(bench):
    bench.scan(200)
    bench.run(200)
    bench.consuming = False
    bench.until(lambda: bench.device.state is DeviceState.SAFE_HOLD)
    bench.consuming = True
    bench.run(500)
    assert bench.device.state is DeviceState.SAFE_HOLD, "nothing re-arms by itself"
    bench.call(Operation.RELEASE)
    bench.start()
    bench.finish()
    bench.check_exact(200)


def test_a_full_ring_stops_firing_and_overwrites_nothing(make_bench):
    bench = make_bench(ring=8)
    bench.acknowledging = False
    bench.scan(40)
    bench.run(2000)
    assert bench.device.state is DeviceState.BLOCKED
    assert len(bench.instrument.log) == 8 == bench.device.ring.used
    bench.acknowledging = True
    bench.host.acknowledge(bench.stored[-1].number, bench.clock.now())
    bench.finish()
    bench.check_exact(40)


def test_a_new_session_switches_the_laser_off_and_offers_unacknowledged_lines_again(bench):
    bench.connect()
    plan = bench.upload(100)
    bench.start()
    bench.run(200)
    bench.acknowledging = False
    bench.run(50)
    acknowledged, shots = bench.device.ring.acknowledged, len(bench.instrument.log)
    assert shots > acknowledged > 0
    bench.host = Host(nonce=2)
    bench.stored = bench.stored[:acknowledged]
    bench.acknowledging = True
    bench.connect()
    bench.run(300)
    assert bench.device.state is DeviceState.SAFE_HOLD
    assert bench.device.ring.sent == acknowledged, "nothing is sent before the new host grants credit"
    assert bench.host.resume_plan(plan, bench.clock.now())
    bench.run(100)
    bench.call(Operation.RELEASE)
    bench.start()
    bench.finish()
    bench.check_exact(100)
    assert len({index for _, index, _ in bench.instrument.log}) == len(bench.instrument.log), "fired twice"


@pytest.mark.parametrize(("session", "boot"), [(-1, 0), (0, 1)])
def test_frames_of_another_session_or_boot_do_nothing_at_the_device(bench, session, boot):
    bench.connect()
    bench.upload(10)
    session, tag = (bench.host.session + session) & 0xFFFF, 0x07 ^ boot
    requests = [REQUEST_HEAD.pack(900 + operation, operation) for operation in Operation]
    for payload in requests:
        data = encode_frame(Frame(Type.REQ, 0, tag, session, 0, payload))
        bench.device.receive(data, bench.device_now)
    assert bench.device.state is DeviceState.READY
    assert not any(bench.device.replies.stale(900 + operation) for operation in Operation), "none carried out"


def test_frames_of_another_session_or_boot_do_nothing_at_the_host(bench, faults):
    recorder = faults.recorder()
    bench.down.filters.append(recorder)
    bench.scan(10)
    bench.finish()
    bench.host, bench.stored = Host(nonce=2), []
    bench.connect()
    plan = bench.upload(10)
    assert plan.uid == bench.host.assembly.plan, "the same plan again, so only the session tells"
    bench.host.receive(recorder.data, bench.clock.now())
    assert not bench.host.take()
    assert bench.host.foreign_frames > 10


def test_a_lease_for_another_boot_id_with_the_same_tag_is_ignored(bench):
    bench.scan(500)
    bench.run(100)
    until = bench.device.lease.until
    lease = pack(Lease(0xB107, bench.device_now, 500_000))
    bench.device.receive(encode_frame(Frame(Type.LEASE, 0, 7, bench.host.session, 0, lease)), bench.device_now)
    assert bench.device.lease.until == until


def test_hello_ack_with_foreign_nonce_is_ignored(bench):
    bench.connect()
    session = bench.host.session
    other = bench.host.hello._replace(nonce=77, session=session ^ 1)
    bench.host.receive(encode_frame(Frame(Type.HELLO_ACK, 0, 7, session ^ 1, 0, pack(other))), bench.clock.now())
    assert bench.host.session == session


def test_an_echo_from_an_earlier_session_cannot_start_a_scan_in_a_new_one(bench):
    bench.connect()
    bench.upload(10)
    old = bench.host.lease_fields()
    bench.host = Host(nonce=2)
    bench.connect()
    token = bench.call(Operation.ARM)["token"]
    assert bench.device_now - old["echo"] < TTL
    with pytest.raises(RequestRejected, match="no-lease"):
        bench.call(Operation.START, token=token, **old)


def test_a_finished_scans_lease_is_of_no_use_to_the_next_one(bench):
    bench.scan(5)
    bench.finish()
    bench.upload(5)
    token = bench.call(Operation.ARM)["token"]
    assert bench.device.lease.permits(bench.device_now)
    with pytest.raises(RequestRejected, match="no-lease"):
        bench.call(Operation.START, token=token, echo=1, ttl=500_000)


def test_a_line_that_takes_no_bytes_does_not_stop_the_devices_time_and_with_it_the_lease(bench):
    bench.scan(5000)
    bench.run(100)
    for _ in range(10_000):
        due = bench.device.next_deadline()
        if due > bench.device_now + 2_000_000:
            break
        bench.device.poll(max(due, bench.device.now))
    assert bench.device.state is DeviceState.SAFE_HOLD


def test_acknowledgement_of_undelivered_alines_is_ignored(bench):
    bench.consuming = False
    bench.scan(20)
    bench.run(100)
    bench.host.acknowledge(15, bench.clock.now())
    bench.run(100)
    assert bench.device.ring.acknowledged == 0


def test_a_device_reboot_is_noticed_and_reported_as_such(bench):
    bench.scan(500)
    bench.run(300)
    bench.device = bench.boot(0xB008)
    bench.until(lambda: bench.host.failure is not None, 5000)
    assert isinstance(bench.host.failure, DeviceRestarted)
    shots = len(bench.instrument.log)
    bench.run(500)
    assert len(bench.instrument.log) == shots


@pytest.mark.parametrize(
    ("level", "state"),
    [
        (AbortLevel.PAUSE, DeviceState.PAUSED),
        (AbortLevel.LASER_OFF, DeviceState.SAFE_HOLD),
        (AbortLevel.EMERGENCY_STOP, DeviceState.ESTOP),
    ],
)
def test_an_abort_ends_emission_at_once_although_its_first_frames_are_lost(bench, faults, level, state):
    bench.up.filters.append(faults.drop(Type.ABORT, lambda n: n < 2))
    bench.scan(500)
    bench.run(300)
    asked = bench.device_now
    bench.host.abort(level, bench.clock.now())
    bench.run(500)
    assert bench.device.state is state
    assert bench.instrument.log[-1][0] < asked + 60_000
    assert not bench.host.aborting


def test_a_weaker_abort_does_not_replace_a_stronger_one_that_is_not_answered_yet(bench, faults):
    bench.up.filters.append(faults.drop(Type.ABORT, lambda n: n < 4))
    bench.scan(500)
    bench.run(300)
    bench.host.abort(AbortLevel.EMERGENCY_STOP, bench.clock.now())
    bench.run(10)
    bench.host.abort(AbortLevel.LASER_OFF, bench.clock.now())
    bench.run(1_000)
    assert bench.device.state is DeviceState.ESTOP
    assert not bench.host.aborting


def test_an_emergency_stop_is_latched_until_cleared(bench):
    bench.connect()
    bench.upload(10)
    bench.host.abort(AbortLevel.EMERGENCY_STOP, bench.clock.now())
    bench.run(50)
    with pytest.raises(RequestRejected, match="wrong-state"):
        bench.call(Operation.ARM)
    bench.call(Operation.CLEAR_FAULT)
    assert bench.device.state is DeviceState.SAFE_HOLD


def test_a_repeated_request_is_carried_out_once_and_answered_again(bench, faults):
    bench.connect()
    bench.upload(10)
    bench.down.filters.append(faults.drop(Type.RSP, lambda n: n == 0))
    first = bench.call(Operation.ARM)["token"]
    assert first == bench.device.token, "the retransmitted ARM must not have made another token"


def test_start_needs_the_right_token_and_a_young_echo(bench):
    bench.connect()
    bench.upload(10)
    token = bench.call(Operation.ARM)["token"]
    fields = bench.host.lease_fields()
    with pytest.raises(RequestRejected, match="bad-token"):
        bench.call(Operation.START, token=token ^ 1, **fields)
    bench.run(600)
    with pytest.raises(RequestRejected, match="no-lease"):
        bench.call(Operation.START, token=token, **fields)
    assert bench.device.state is DeviceState.ARMED
    assert bench.instrument.log == []


def test_an_unused_arm_token_expires(bench):
    bench.connect()
    bench.upload(10)
    token = bench.call(Operation.ARM)["token"]
    bench.run(30_001)
    with pytest.raises(RequestRejected):
        bench.call(Operation.START, token=token, **bench.host.lease_fields())
    assert bench.device.state is DeviceState.READY


def test_interrupted_average_is_refired_and_its_shots_counted_as_wasted(bench):
    bench.scan(6, averages=10)
    bench.until(lambda: len(bench.instrument.log) == 14)
    bench.host.abort(AbortLevel.PAUSE, bench.clock.now())
    bench.run(50)
    assert bench.device.state is DeviceState.PAUSED
    bench.start()
    bench.finish()
    bench.check_exact(6)
    assert all(line.averages == 10 for line in bench.stored)
    assert bench.device.scan.shots == 6 * 10 + bench.device.scan.shots_wasted
    assert bench.device.scan.shots_wasted >= 4


def test_a_fault_of_the_hardware_in_mid_scan_is_latched_reported_by_its_code_and_fires_nothing_more(bench):
    bench.scan(50)
    bench.run(60)

    def fail(now: int) -> None:
        raise InstrumentError(7, "the mirror does not move")

    bench.instrument.on_fire = fail
    bench.run(300)
    assert bench.device.state is bench.host.device_state is DeviceState.FAULT
    assert bench.host.status.fault == 7
    fired = len(bench.instrument.log)
    bench.instrument.on_fire = lambda now: None
    bench.run(1_000)
    assert len(bench.instrument.log) == fired
    bench.call(Operation.CLEAR_FAULT)
    assert bench.device.state is DeviceState.SAFE_HOLD


@pytest.mark.parametrize("error", [PlanInvalid("samples", 9, "1 … 8"), RequestRejected("ARM", "no-lease", "READY")])
def test_error_pickle_round_trip_preserves_message_and_attributes(error):
    again = pickle.loads(pickle.dumps(error))  # noqa: S301
    assert str(again) == str(error)
    assert vars(again) == vars(error)
