"""Conformance tests of laser emission: conditions that must turn the laser off, or must not turn it on."""

from __future__ import annotations

import secrets

from fabry_perot.conformance.peer import QUIET_PERIOD, ConformanceHost
from fabry_perot.conformance.registry import ConformanceFunction, conformance_test
from fabry_perot.conformance.scan_helpers import (
    connect_during_scan,
    expect_lease_expiry,
    expect_no_emission,
    many,
    renew_without_proof,
    start_scan,
)
from fabry_perot.wire.constants import SAFE_BITS, AbortLevel, Operation, Result
from fabry_perot.wire.states import DeviceState, HoldCause


@conformance_test("lease", fires=True)  # it does where the device starts although it must not
def arm_token(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """START requires the current arm token and a fresh time echo; each ARM creates a new token."""
    peer.upload(many(peer))
    while peer.fresh() <= 2 * peer.ttl:  # just booted: there is no echo yet that is too old
        pass
    first = peer.request_ok(Operation.ARM)["token"]
    echo = peer.fresh()
    wrong = peer.request(Operation.START, token=(first + 1) & 0xFFFFFFFF, echo=echo, ttl=peer.ttl)
    peer.expect(wrong.result == Result.BAD_TOKEN, "result 3 for a wrong token")
    second = peer.request_ok(Operation.ARM)["token"]
    peer.expect(first != second, "another token for another ARM")
    late = peer.request(Operation.START, token=second, echo=max(0, echo - 3 * peer.ttl), ttl=peer.ttl)
    peer.expect(late.result == Result.NO_LEASE, "result 4 for an echo that is too old")
    peer.expect(peer.state is DeviceState.ARMED, "ARMED still, its token kept")
    peer.request_ok(Operation.DISARM)
    reply = peer.request(Operation.START, token=second, echo=peer.fresh(), ttl=peer.ttl)
    peer.expect(reply.result == Result.WRONG_STATE, "no START after DISARM")


@conformance_test("lease", fires=True)
def earlier_session(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """START with a time echo from before the session is rejected."""
    old = peer.fresh()
    peer.connect()
    peer.upload(many(peer))
    token = peer.request_ok(Operation.ARM)["token"]
    reply = peer.request(Operation.START, token=token, echo=old, ttl=int(peer.limits["lease_cap_us"]))
    peer.expect(reply.result == Result.NO_LEASE, "result 4 for an echo from before the session")


@conformance_test("lease", fires=True)
def lease_expiry(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """If the host is silent, the lease expires, the laser goes off, and LEASE does not switch the laser on again."""
    start_scan(peer)
    peer.renewing = False
    expect_lease_expiry(peer, "nobody renews the lease")
    peer.lease(peer.fresh())
    peer.listen(QUIET_PERIOD)
    peer.expect(peer.state is DeviceState.SAFE_HOLD, "SAFE_HOLD until RELEASE, whatever LEASE says")
    peer.abort(AbortLevel.LASER_OFF)
    peer.fresh()
    peer.expect(
        peer.status is not None and peer.status.cause == HoldCause.REQUEST, "hold cause 3 after an ABORT meanwhile"
    )


@conformance_test("lease", fires=True)
def stale_echo(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """Repetition of one old time echo does not extend the lease: the age of the echo counts, not its arrival."""
    start_scan(peer)
    peer.renewing, echo = False, peer.now()
    renew_without_proof(peer, lambda: echo)
    expect_lease_expiry(peer, "each renewal echoes the same old time")


@conformance_test("lease", fires=True)
def future_echo(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """A time echo from the future does not extend the lease, and is counted."""
    start_scan(peer)
    peer.renewing = False
    renew_without_proof(peer, lambda: peer.now() + round(60_000_000 * peer.rate))
    expect_lease_expiry(peer, "each renewal echoes a time that has yet to come")
    peer.expect(peer.request_ok(Operation.GET)["impossible_echoes"] > 0, "impossible_echoes to count them")


@conformance_test("lease", fires=True)
def new_session(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """A new session turns the laser off."""
    connect_during_scan(peer)
    peer.expect(peer.state is DeviceState.SAFE_HOLD, "SAFE_HOLD at the beginning of another session")
    peer.expect(peer.status is not None and peer.status.cause == HoldCause.SESSION, "hold cause 2")
    expect_no_emission(peer)


@conformance_test("lease", fires=True, asks=True)
def interlock(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """An interlock that opens while the laser fires causes a latched fault."""
    start_scan(peer)
    ask("open the interlock")
    peer.expect(peer.wait(lambda: peer.state is DeviceState.FAULT, 2.0), "FAULT when the interlock opens")
    peer.expect(
        peer.status is not None and peer.status.laser & SAFE_BITS != SAFE_BITS, "the laser bit of the interlock clear"
    )
    expect_no_emission(peer)
    refused = peer.request(Operation.CLEAR_FAULT).result == Result.WRONG_STATE and peer.state is DeviceState.FAULT
    peer.expect(refused, "CLEAR_FAULT refused with result 1 while the interlock is open")
    ask("close the interlock")
    peer.listen(QUIET_PERIOD)
    peer.expect(peer.state is DeviceState.FAULT, "FAULT until CLEAR_FAULT, though the interlock is closed again")
    peer.expect(peer.status is not None and peer.status.laser & SAFE_BITS == SAFE_BITS, "the interlock's bit set")


@conformance_test("abort")
def emergency_stop(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """An emergency stop is accepted in any session, acknowledged, and latched until it is cleared."""
    peer.upload(4)
    ack = peer.abort(AbortLevel.EMERGENCY_STOP)
    peer.expect(ack.state == DeviceState.ESTOP, "ABORT_ACK with ESTOP")
    peer.expect(peer.request(Operation.ARM).result == Result.WRONG_STATE, "no ARM in ESTOP")
    peer.expect(peer.request(Operation.PARK).result == Result.WRONG_STATE, "no PARK in ESTOP")
    peer.connect()
    peer.expect(peer.state is DeviceState.ESTOP, "ESTOP in another session, too")
    peer.request_ok(Operation.CLEAR_FAULT)
    peer.expect(peer.state is DeviceState.SAFE_HOLD, "SAFE_HOLD after CLEAR_FAULT")
    known, peer.hello = peer.hello, None
    peer.forget()
    ack = peer.abort(AbortLevel.EMERGENCY_STOP)
    peer.hello = known
    peer.expect(ack.state == DeviceState.ESTOP, "ABORT of no session taken and acknowledged")


@conformance_test("abort", fires=True)
def abort_levels(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """Pause, laser off, and an unknown level each end emission and close the shutter."""
    after = ((1, DeviceState.PAUSED), (2, DeviceState.SAFE_HOLD), (77, DeviceState.SAFE_HOLD), (3, DeviceState.ESTOP))
    for level, state in after:
        peer.prepare()
        start_scan(peer)
        ack = peer.abort(level)
        peer.expect(ack.state == state, f"{state.name} after ABORT {level}, not {ack.state}")
        expect_no_emission(peer)


@conformance_test("reboot", asks=True)
def reboot(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """After a loss of power the boot id differs, the laser is off, and plan and A-lines are lost."""
    peer.upload(4)
    before = peer.hello.boot if peer.hello else 0
    ask("switch the device off and on again")
    for _ in range(20):
        ack = peer.open_session(1 + secrets.randbelow(0xFFFFFFFE))
        if ack is not None:
            break
    peer.expect(ack is not None and ack.boot != before, "another boot id")
    peer.expect(ack is not None and (ack.plan, ack.produced) == (0, 0), "no plan and no A-line")
    peer.connect()
    peer.expect(peer.state in (DeviceState.IDLE, DeviceState.LINKED), "LINKED after HELLO")
    expect_no_emission(peer)
