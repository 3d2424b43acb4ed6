"""Helper functions of conformance tests that need a running scan."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil

from fabry_perot.conformance.peer import QUIET_PERIOD, ConformanceHost, Failed
from fabry_perot.wire.constants import LASER_EMITTING, SHUTTER_OPEN
from fabry_perot.wire.states import RUNNING, DeviceState, HoldCause

RING_HEADROOM = 1 << 30
"""Credit without end."""
LOOK = 4.0
"""Seconds for which a plan is looked at, which is not to end meanwhile."""
PROMPT_SECONDS = 1.0
"""Seconds beyond the lease's end within which a host has heard of it, on a busy machine too."""
SILENCE_SECONDS = 5.0
"""Seconds within which a simulated device that has too little processor time reports its state."""
SESSION_TRIES = 4
"""Scans in one of which the lease must not expire before a new session is opened."""


def many(peer: ConformanceHost) -> int:
    """Return the number of points of a plan that lasts longer than a test, at any speed of the device's clock.

    A plan that is longer than the ring blocks the laser, and ends only when A-lines are acknowledged.
    """
    assert peer.hello is not None  # noqa: S101
    fired = ceil(LOOK * peer.rate * peer.pulse_rate * 1e-3)
    return max(400, min(fired, peer.hello.ring + 40))


def start_scan(peer: ConformanceHost) -> None:
    """Start a scan that continues as long as its lease is renewed."""
    peer.upload(many(peer))
    peer.acknowledge(0, RING_HEADROOM)
    peer.start()
    peer.expect(peer.wait(lambda: peer.status is not None and peer.status.produced > 2, 3.0), "A-lines after START")


def connect_during_scan(peer: ConformanceHost) -> None:
    """Start a scan and open a new session before the lease expires.

    On a busy machine HELLO may arrive after the end of the lease. The scan is then started again, a few times.
    """
    for attempt in range(SESSION_TRIES):
        if attempt:
            peer.prepare()
        start_scan(peer)
        peer.renewing = False
        peer.forget()
        opened, status = peer.connect().device_time, peer.status
        if status is None or status.cause != HoldCause.LEASE or status.lease_until >= opened:
            return


def renew_without_proof(peer: ConformanceHost, echo: Callable[[], int]) -> None:
    """Send lease renewals without a valid echo for longer than a lease, and check that the laser goes off.

    The laser must then be off.
    """

    def stopped_after_renewal() -> bool:
        peer.lease(echo())
        return peer.wait(lambda: peer.state not in RUNNING, 0.05)

    if not wait_one_lease(peer, stopped_after_renewal):
        raise Failed("expected: the laser off, although LEASE comes, since its echo proves nothing")


def wait_one_lease(peer: ConformanceHost, stopped: Callable[[], bool]) -> bool:
    """Repeat ``stopped()`` until it is true or a lease without renewals has expired; return whether it is true.

    A simulated device is timed by its own clock, which waits while an A-line takes longer to compute than the
    declared rate allows. Any other device is timed by the host's clock.
    """
    longest = peer.ttl + PROMPT_SECONDS * 1e6 * peer.rate
    simulated = bool(peer.limits.get("simulated"))

    def elapsed() -> float:
        return peer.now() if simulated else peer.host_time() * peer.rate

    begin, seen, heard = elapsed(), peer.now(), peer.host_time()
    while not stopped():
        if peer.now() != seen:
            seen, heard = peer.now(), peer.host_time()
        if elapsed() - begin > longest or peer.host_time() - heard > SILENCE_SECONDS * 1e6:
            return False
    return True


def expect_lease_expiry(peer: ConformanceHost, what: str) -> None:
    """Wait until the lease has expired, and check that no shot was fired after its end."""
    stopped = wait_one_lease(peer, lambda: peer.wait(lambda: peer.state not in RUNNING, 0.05))
    peer.expect(stopped, f"the laser off: {what}")
    peer.expect(peer.state is DeviceState.SAFE_HOLD, f"SAFE_HOLD: {what}")
    status = peer.status
    peer.expect(status is not None and status.cause == HoldCause.LEASE, "hold cause 1")
    peer.expect(status is not None and status.last_shot < status.lease_until, "the last shot before the lease's end")
    expect_no_emission(peer)


def expect_no_emission(peer: ConformanceHost) -> None:
    """Check that the shutter is closed and that no shot is fired."""
    peer.listen(QUIET_PERIOD)
    laser = peer.status.laser if peer.status else 0xFF
    peer.expect(not laser & (SHUTTER_OPEN | LASER_EMITTING), f"shutter closed and laser off in {peer.state.name}")
    shots = peer.status.shots if peer.status else 0
    peer.listen(QUIET_PERIOD)
    peer.expect(peer.status is not None and peer.status.shots == shots, f"no shot in {peer.state.name}")
