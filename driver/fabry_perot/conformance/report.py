"""Conformance test runner, and reports as text or JUnit XML."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple
from xml.etree import ElementTree  # it is written only

from fabry_perot.conformance.peer import ConformanceHost, Failed
from fabry_perot.conformance.registry import SCENARIOS, ConformanceFunction, ConformanceTest
from fabry_perot.errors import LinkLost, PlanInvalid
from fabry_perot.wire.constants import AbortLevel

ABSENCE_TIMEOUT = 0.15
"""Seconds: a host that did not look at the line for longer tells nothing of the device; the scenario is tried again."""
MAX_TRIES = 4


class ConformanceResult(NamedTuple):
    """Outcome of a conformance test."""

    scenario: ConformanceTest
    failure: str
    """Why it failed; empty when it did not."""
    skipped: str
    """Why it was not run; empty when it was."""
    seconds: float

    @property
    def name(self) -> str:
        """Name of the conformance test."""
        return self.scenario.run.__name__


def run(
    peer: ConformanceHost,
    *,
    fire: bool = False,
    ask: ConformanceFunction | None = None,
    only: Sequence[str] = (),
    told: Callable[[ConformanceResult], None] = lambda outcome: None,
) -> list[ConformanceResult]:
    """Run the conformance tests on a device.

    Parameters
    ----------
    peer
        At the device's line.
    fire
        Also those that open the shutter; a device that says that it is simulated is always fired.
    ask
        Has a person do what scenarios need (power, interlock); ``None``: those are skipped.
    only
        Names; by default all.
    told
        Called after each.

    Raises
    ------
    PlanInvalid
        When ``only`` has a name that no scenario has.
    """
    names = [scenario.run.__name__ for scenario in SCENARIOS]
    if unknown := [name for name in only if name not in names]:
        raise PlanInvalid("only", ", ".join(unknown), ", ".join(names))
    outcomes = []
    for name, scenario in zip(names, SCENARIOS, strict=True):
        if not only or name in only:
            outcomes.append(_run(scenario, peer, fire, ask))
            told(outcomes[-1])
    return outcomes


def _run(
    scenario: ConformanceTest, peer: ConformanceHost, fire: bool, ask: ConformanceFunction | None
) -> ConformanceResult:
    start, failure = time.monotonic(), ""
    if scenario.asks and ask is None:
        return ConformanceResult(scenario, "", "needs a person (--ask)", 0.0)
    for _ in range(MAX_TRIES):
        peer.absence, failure = 0.0, ""
        try:
            peer.prepare()
            if scenario.fires and not (fire or peer.limits.get("simulated")):
                return ConformanceResult(scenario, "", "may open the shutter (--fire)", 0.0)
            scenario.run(peer, ask or (lambda wish: None))
        except Failed as error:
            failure = str(error)
        except LinkLost as error:
            failure = f"the line was lost: {error}"
        except (KeyError, IndexError, TypeError, ValueError) as error:
            failure = f"an answer lacks or garbles {error}"
        finally:
            _make_safe(peer)
        if not failure or peer.absence < ABSENCE_TIMEOUT or scenario.asks:
            break
    return ConformanceResult(scenario, failure, "", time.monotonic() - start)


def _make_safe(peer: ConformanceHost) -> None:
    """Stop a running scan after a test."""
    peer.renewing = False
    try:
        peer.abort(AbortLevel.LASER_OFF)
    except (Failed, LinkLost, KeyError, IndexError, TypeError, ValueError):
        return


def as_table(outcomes: Iterable[ConformanceResult]) -> str:
    """Return the results as text, one line per test."""
    lines = []
    for outcome in outcomes:
        word = "FAILED " if outcome.failure else "skipped" if outcome.skipped else "ok     "
        why = outcome.failure or outcome.skipped
        told = f"{outcome.scenario.title}{': ' + why if why else ''}"
        lines.append(f"{word}  {outcome.scenario.group:<6}  {outcome.name:<15}  {told}")
    return "\n".join(lines)


def as_junit(outcomes: Sequence[ConformanceResult], port: str) -> bytes:
    """Return the results as JUnit XML for continuous integration."""
    counts = {
        "tests": len(outcomes),
        "failures": sum(bool(outcome.failure) for outcome in outcomes),
        "skipped": sum(bool(outcome.skipped) for outcome in outcomes),
    }
    about = {"name": f"conformance of {port}", **{key: str(value) for key, value in counts.items()}}
    suite = ElementTree.Element("testsuite", about)
    for outcome in outcomes:
        case = ElementTree.SubElement(
            suite,
            "testcase",
            classname=f"conformance.{outcome.scenario.group}",
            name=outcome.name,
            time=f"{outcome.seconds:.3f}",
        )
        if outcome.failure:
            ElementTree.SubElement(case, "failure", message=outcome.failure).text = outcome.scenario.title
        elif outcome.skipped:
            ElementTree.SubElement(case, "skipped", message=outcome.skipped)
    return bytes(ElementTree.tostring(suite, encoding="utf-8", xml_declaration=True))
