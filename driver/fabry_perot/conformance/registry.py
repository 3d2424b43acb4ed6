"""Registry of the conformance tests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from fabry_perot.conformance.peer import ConformanceHost

ConformanceFunction = Callable[[str], None]
"""Has a person do something to the device, and returns when it is done."""


@dataclass(frozen=True, slots=True)
class ConformanceTest:
    """Conformance test: group, title, function, and its effects on laser and operator.

    Parameters
    ----------
    group
        Part of the protocol.
    title
        What is tried.
    run
        Tries it on a device in a new session.
    fires
        Whether the shutter is opened, by a device that does what it should or by one that does not.
    asks
        Whether a person has to do something.
    """

    group: str
    title: str
    run: Callable[[ConformanceHost, ConformanceFunction], None]
    fires: bool = False
    asks: bool = False


SCENARIOS: list[ConformanceTest] = []


def conformance_test(
    group: str, *, fires: bool = False, asks: bool = False
) -> Callable[
    [Callable[[ConformanceHost, ConformanceFunction], None]], Callable[[ConformanceHost, ConformanceFunction], None]
]:
    """Decorator that registers a conformance test, whose docstring is its title."""

    def add(
        run: Callable[[ConformanceHost, ConformanceFunction], None],
    ) -> Callable[[ConformanceHost, ConformanceFunction], None]:
        SCENARIOS.append(ConformanceTest(group, (run.__doc__ or "").rstrip("."), run, fires, asks))
        return run

    return add
