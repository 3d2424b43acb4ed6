"""Tests of laser emission: conditions that must turn the laser off, and those that must not turn it on."""

from __future__ import annotations

import secrets

from fabry_perot.conformance.peer import QUIET, Peer
from fabry_perot.conformance.running import dark, lapsed, many, renewed, scanning
from fabry_perot.conformance.scenarios import Asking, scenario
from fabry_perot.wire.codes import SECURED, AbortLevel, Operation, Result
from fabry_perot.wire.states import DeviceState, HoldCause


@scenario("lease", fires=True)  # it does where the device starts although it must not
def token(peer: Peer, ask: Asking) -> None:
    """START requires the current token and a fresh echo; each ARM creates a new token."""
    peer.upload(many(peer))
    first = peer.succeed(Operation.ARM)["token"]
    echo = peer.fresh()
    wrong = peer.request(Operation.START, token=(first + 1) & 0xFFFFFFFF, echo=echo, ttl=peer.ttl)
    peer.need(wrong.result == Result.BAD_TOKEN, "result 3 for a wrong token")
    second = peer.succeed(Operation.ARM)["token"]
    peer.need(first != second, "another token for another ARM")
    late = peer.request(Operation.START, token=second, echo=max(0, echo - 3 * peer.ttl), ttl=peer.ttl)
    peer.need(late.result == Result.NO_LEASE, "result 4 for an echo that is too old")
    peer.need(peer.state is DeviceState.ARMED, "ARMED still, its token kept")
    peer.succeed(Operation.DISARM)
    reply = peer.request(Operation.START, token=second, echo=peer.fresh(), ttl=peer.ttl)
    peer.need(reply.result == Result.WRONG_STATE, "no START after DISARM")


@scenario("lease", fires=True)
def earlier_session(peer: Peer, ask: Asking) -> None:
    """An echo from before the session starts nothing."""
    old = peer.fresh()
    peer.connect()
    peer.upload(many(peer))
    token = peer.succeed(Operation.ARM)["token"]
    reply = peer.request(Operation.START, token=token, echo=old, ttl=int(peer.limits["lease_cap_us"]))
    peer.need(reply.result == Result.NO_LEASE, "result 4 for an echo from before the session")


@scenario("lease", fires=True)
def silence(peer: Peer, ask: Asking) -> None:
    """A host that falls silent: the lease lapses, the laser is off, and no LEASE brings it back."""
    scanning(peer)
    peer.renewing = False
    lapsed(peer, "nobody renews the lease")
    peer.lease(peer.fresh())
    peer.listen(QUIET)
    peer.need(peer.state is DeviceState.SAFE_HOLD, "SAFE_HOLD until RELEASE, whatever LEASE says")
    peer.abort(AbortLevel.LASER_OFF)
    peer.fresh()
    peer.need(
        peer.status is not None and peer.status.cause == HoldCause.REQUEST, "hold cause 3 after an ABORT meanwhile"
    )


@scenario("lease", fires=True)
def old_echo(peer: Peer, ask: Asking) -> None:
    """The same old echo over and over keeps no laser on: age counts, not arrival."""
    scanning(peer)
    peer.renewing, echo = False, peer.now()
    renewed(peer, lambda: echo)
    lapsed(peer, "each renewal echoes the same old time")


@scenario("lease", fires=True)
def future(peer: Peer, ask: Asking) -> None:
    """An echo of the future keeps no laser on, and is counted."""
    scanning(peer)
    peer.renewing = False
    renewed(peer, lambda: peer.now() + round(60_000_000 * peer.rate))
    lapsed(peer, "each renewal echoes a time that has yet to come")
    peer.need(peer.succeed(Operation.GET)["impossible_echoes"] > 0, "impossible_echoes to count them")


@scenario("lease", fires=True)
def new_session(peer: Peer, ask: Asking) -> None:
    """A new session turns the laser off."""
    scanning(peer)
    peer.renewing = False
    peer.forget()
    peer.connect()
    peer.need(peer.state is DeviceState.SAFE_HOLD, "SAFE_HOLD at the beginning of another session")
    peer.need(peer.status is not None and peer.status.cause == HoldCause.SESSION, "hold cause 2")
    dark(peer)


@scenario("lease", fires=True, asks=True)
def interlock(peer: Peer, ask: Asking) -> None:
    """An interlock that opens while the laser fires is a fault that lasts."""
    scanning(peer)
    ask("open the interlock")
    peer.need(peer.wait(lambda: peer.state is DeviceState.FAULT, 2.0), "FAULT when the interlock opens")
    peer.need(
        peer.status is not None and peer.status.laser & SECURED != SECURED, "the laser bit of the interlock clear"
    )
    dark(peer)
    refused = peer.request(Operation.CLEAR_FAULT).result == Result.WRONG_STATE and peer.state is DeviceState.FAULT
    peer.need(refused, "CLEAR_FAULT refused with result 1 while the interlock is open")
    ask("close the interlock")
    peer.listen(QUIET)
    peer.need(peer.state is DeviceState.FAULT, "FAULT until CLEAR_FAULT, though the interlock is closed again")
    peer.need(peer.status is not None and peer.status.laser & SECURED == SECURED, "the interlock's bit set")


@scenario("abort")
def emergency_stop(peer: Peer, ask: Asking) -> None:
    """An emergency stop is taken in any session, acknowledged, and latched until it is cleared."""
    peer.upload(4)
    ack = peer.abort(AbortLevel.EMERGENCY_STOP)
    peer.need(ack.state == DeviceState.ESTOP, "ABORT_ACK with ESTOP")
    peer.need(peer.request(Operation.ARM).result == Result.WRONG_STATE, "no ARM in ESTOP")
    peer.need(peer.request(Operation.PARK).result == Result.WRONG_STATE, "no PARK in ESTOP")
    peer.connect()
    peer.need(peer.state is DeviceState.ESTOP, "ESTOP in another session, too")
    peer.succeed(Operation.CLEAR_FAULT)
    peer.need(peer.state is DeviceState.SAFE_HOLD, "SAFE_HOLD after CLEAR_FAULT")
    known, peer.hello = peer.hello, None
    peer.forget()
    ack = peer.abort(AbortLevel.EMERGENCY_STOP)
    peer.hello = known
    peer.need(ack.state == DeviceState.ESTOP, "ABORT of no session taken and acknowledged")


@scenario("abort", fires=True)
def aborts(peer: Peer, ask: Asking) -> None:
    """Pause, laser off, and an unknown level each end emission and close the shutter."""
    after = ((1, DeviceState.PAUSED), (2, DeviceState.SAFE_HOLD), (77, DeviceState.SAFE_HOLD), (3, DeviceState.ESTOP))
    for level, state in after:
        peer.prepare()
        scanning(peer)
        ack = peer.abort(level)
        peer.need(ack.state == state, f"{state.name} after ABORT {level}, not {ack.state}")
        dark(peer)


@scenario("reboot", asks=True)
def reboot(peer: Peer, ask: Asking) -> None:
    """After a loss of power the boot id is another one, the laser off, plan and A-lines gone."""
    peer.upload(4)
    before = peer.hello.boot if peer.hello else 0
    ask("switch the device off and on again")
    for _ in range(20):
        ack = peer.say_hello(1 + secrets.randbelow(0xFFFFFFFE))
        if ack is not None:
            break
    peer.need(ack is not None and ack.boot != before, "another boot id")
    peer.need(ack is not None and (ack.plan, ack.produced) == (0, 0), "no plan and no A-line")
    peer.connect()
    peer.need(peer.state in (DeviceState.IDLE, DeviceState.LINKED), "LINKED after HELLO")
    dark(peer)
