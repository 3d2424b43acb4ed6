"""Timeouts of the host."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class HostTiming:
    """Time limits in µs of host time.

    Parameters
    ----------
    hello_period, hello_tries
        Repetition of HELLO.
    connect
        A device that has answered must be ready within so long of the first HELLO, unless it gets on.
    request_period, request_tries
        Repetition of a request without a reply.
    silence
        Without STATUS for so long the link counts as lost (it may come back).
    patience
        Without STATUS for so long waiting for it is given up.
    ack_period
        Repetition of ALINE_ACK while the device has not confirmed it, and of the request for one missing A-line.
    upload_period
        Repetition of PLAN_DATA without progress.
    abort_period
        Repetition of ABORT.
    lease_period
        Between two LEASE while the consumer consumes.
    ttl
        Time to live asked for a lease.
    keepalive
        Without anything to send for so long a lone zero byte goes out, so that a TCP endpoint knows the host lives.
    """

    hello_period: int = 250_000
    hello_tries: int = 18
    connect: int = 5_000_000
    request_period: int = 500_000
    request_tries: int = 5
    silence: int = 400_000
    patience: int = 5_000_000
    ack_period: int = 100_000
    upload_period: int = 250_000
    abort_period: int = 20_000
    lease_period: int = 25_000
    ttl: int = 500_000
    keepalive: int = 1_000_000
