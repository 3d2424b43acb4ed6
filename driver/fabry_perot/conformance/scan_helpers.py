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


def renew_without_proof(peer: ConformanceHost, echo: Callable[[], int]) -> None:
    """Send lease renewals without a valid echo for longer than a lease, and check that the laser goes off.

    The laser must then be off.
    """
    for _ in range(round((peer.ttl / peer.rate * 1e-6 + PROMPT_SECONDS) / 0.05)):
        peer.lease(echo())
        if peer.wait(lambda: peer.state not in RUNNING, 0.05):
            return
    raise Failed("expected: the laser off, although LEASE comes, since its echo proves nothing")


def expect_lease_expiry(peer: ConformanceHost, what: str) -> None:
    """Wait until the lease has expired, and check that no shot was fired after its end."""
    longest = (peer.ttl / peer.rate) * 1e-6 + PROMPT_SECONDS
    peer.expect(peer.wait(lambda: peer.state not in RUNNING, longest), f"the laser off: {what}")
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
