"""Further stages of a running scan: decision while the laser is off, extension of the file, and measurement."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

import fabry_perot
from steradian.core.exceptions import Conflict, DiskFull, InvalidInput, ScanInterrupted, SteradianError
from steradian.plans import ScanPlan
from steradian.plans.preview import preview
from steradian.plans.stages import FocusStage, Points, Proposal, StageRecord
from steradian.scans.acquisition.scanner_checks import check_scanner
from steradian.scans.acquisition.session import ScanSession
from steradian.scans.acquisition.session_control import (
    TERMINAL_COMMANDS,
    Command,
    SessionControl,
    SessionOutcome,
    SessionPhase,
)
from steradian.scans.acquisition.stopping import stopping_monitor
from steradian.scans.file.stages import extend_scan_file, read_stages
from steradian.scans.file.writer import ScanFileWriter

POLL: Final = 0.05
"""Seconds between two polls of the command while the next stage is decided."""
LONGEST_AUTOMATIC: Final = 60.0
"""Seconds from the end of a stage within which the next one may begin without a person."""
BY_RULE: Final = "auto"
BY_PLAN: Final = "plan"
BY_CALLER: Final = "caller"
_T = TypeVar("_T")
_log = logging.getLogger(__name__)


class StagePlanner(Protocol):
    """Interface of the computation of stages from the A-lines measured so far."""

    def propose(self, path: Path, stage: FocusStage) -> tuple[Proposal, ...]:
        """Return points of interest found in the image of a scan file's A-lines, by the rule of a stage."""
        ...

    def next_plan(self, plan: ScanPlan, points: Points) -> ScanPlan:
        """Return the plan of the next stage around points of interest."""
        ...

    def enough(self, path: Path, plan: ScanPlan) -> str:
        """Return why a scan has enough points, by the stopping rule of its plan; empty: it has not."""
        ...

    def cancel(self) -> None:
        """Abandon a call in progress, which then raises an error."""
        ...


class _Ended(Exception):
    """A command that ends the session arrived while a stage was decided."""

    def __init__(self, wish: Command) -> None:
        self.wish = wish


def rows_of_stage(store: ScanFileWriter, plan: ScanPlan) -> NDArray[np.bool_]:
    """Return the missing rows (F·M,) of the present stage; before a further stage of the first frame only."""
    missing = store.missing
    if plan.stages:
        missing[plan.mask.count :] = False
    if plan.stopping is not None and plan.stopping.max_points is not None:
        rows = store.course.order[missing[store.course.order]]
        missing[rows[max(0, plan.stopping.max_points - store.stored) :]] = False
    return missing


def acquire_stage(
    session: ScanSession,
    store: ScanFileWriter,
    plan: ScanPlan,
    control: SessionControl,
    enough: Callable[[], str],
    again: NDArray[np.bool_] | None = None,
) -> SessionOutcome:
    """Measure the present stage, and no more points than the stopping rule of the plan allows.

    Parameters
    ----------
    session, store, plan, control
        Session on the open scan file, and its plan.
    enough
        As of :meth:`.ScanSession.acquire`.
    again
        (F·M,) rows that are measured again.
    """
    wanted = rows_of_stage(store, plan)
    capped = not plan.stages and bool((store.missing & ~wanted).any())
    rows = wanted if again is None else wanted | again
    outcome = session.acquire(rows, last=not (plan.stages or capped), enough=enough)
    if outcome is SessionOutcome.COMPLETE and capped and plan.stopping is not None:
        control.on_enough(f"enough: {plan.stopping.max_points} points, as many as agreed to")
        control.on_phase(SessionPhase.STOPPING)
        return SessionOutcome.ENOUGH
    return outcome


def check_stage_arguments(plan: ScanPlan, planner: StagePlanner | None, chosen: Points) -> None:
    """Raise :class:`InvalidInput` for a missing planner, or for points of interest of a stage that does not exist."""
    if chosen and not plan.stages:
        raise InvalidInput("chosen", chosen, "none: the scan has no further stage")
    if (plan.stages or plan.stopping is not None) and planner is None:
        raise InvalidInput("planner", None, "a StagePlanner, for a plan with further stages or a stopping rule")


def measure_further_stages(
    scanner: fabry_perot.Scanner,
    path: Path,
    plan: ScanPlan,
    control: SessionControl,
    within: float,
    planner: StagePlanner | None,
    chosen: Points = (),
) -> SessionOutcome:
    """Decide, store and measure the further stages of a plan whose own points are measured.

    Parameters
    ----------
    scanner
        Connected; its laser is off whenever no stage is measured.
    path
        The scan file, not open for writing.
    plan
        Plan of the file.
    control
        Source of commands and decisions.
    within
        As of :class:`.ScanSession`.
    planner
        Computation of stages.
    chosen
        Points of interest of the next stage that a person has chosen already.

    Raises
    ------
    ScanInterrupted
        When a stage cannot be decided, computed or stored; the file holds every A-line.
    """
    while plan.stages:
        assert planner is not None  # noqa: S101 - for the type checker
        try:
            plan = _begin_next_stage(scanner.capabilities, path, plan, planner, control, chosen)
        except _Ended as end:
            with ScanFileWriter(path) as store:
                return ScanSession(scanner, store, control, within).leave(end.wish)
        chosen = ()
        while control.command() is Command.PAUSE:
            control.wait(POLL)
        with ScanFileWriter(path) as store, stopping_monitor(path, plan, planner) as enough:
            session = ScanSession(scanner, store, control, within)
            outcome = acquire_stage(session, store, plan, control, enough)
        if outcome is not SessionOutcome.COMPLETE:
            return outcome
    return SessionOutcome.COMPLETE


def _begin_next_stage(
    capabilities: fabry_perot.Capabilities,
    path: Path,
    plan: ScanPlan,
    planner: StagePlanner,
    control: SessionControl,
    chosen: Points,
) -> ScanPlan:
    """Return the plan of the next stage, which the scan file then has."""
    stage, number = plan.stages[0], _count_stages(path) + 1
    control.on_phase(SessionPhase.PLANNING)
    decided_by = BY_CALLER
    proposals: tuple[Proposal, ...] = ()
    if not chosen:
        chosen, decided_by = control.decision(number) or (stage.points_of_interest, BY_PLAN)
    if not chosen:
        began = time.monotonic()
        proposals = _propose(path, stage, planner, control)
        chosen, decided_by = _decide(control, number, stage, proposals, began)
    try:
        following = _compute(lambda: planner.next_plan(plan, chosen), planner, control)
        refuse_beyond_agreement(plan, following)
        check_scanner(following, capabilities)
    except (InvalidInput, fabry_perot.PlanInvalid) as error:
        raise ScanInterrupted(
            f"stage {number} cannot be measured around {chosen}: {error}; choose other points of interest and resume"
        ) from error
    while (wish := control.command()) is Command.PAUSE:
        control.wait(POLL)
    if wish in TERMINAL_COMMANDS:
        raise _Ended(wish)
    record = StageRecord(
        number=number,
        points=following.mask.count - plan.mask.count,
        plan_id=following.id,
        points_of_interest=chosen,
        proposals=proposals,
        decided_by=decided_by,
        made=datetime.now(UTC).isoformat(timespec="seconds"),
    )
    try:
        extend_scan_file(path, following, record)
    except (DiskFull, Conflict, OSError) as error:
        raise ScanInterrupted(f"stage {number} cannot be stored: {error}; resume the scan") from error
    control.on_stages(read_stages(path), following)
    return following


def refuse_beyond_agreement(plan: ScanPlan, following: ScanPlan) -> None:
    """Raise :class:`InvalidInput` for a next stage with more shots, another aperture or other shots than agreed to."""
    same = ("pulse_rate", "averages", "samples", "sampling_interval", "frames", "excitation", "scanner", "stopping")
    for name in same:
        if getattr(plan, name) != getattr(following, name):
            raise InvalidInput(name, getattr(following, name), f"{getattr(plan, name)}, as agreed to")
    if following.most_points > plan.most_points:
        raise InvalidInput("points", following.most_points, f"at most {plan.most_points}, as agreed to")
    if following.mask.aperture > plan.mask.aperture:
        raise InvalidInput(
            "aperture", f"{following.mask.aperture:g}", f"at most {plan.mask.aperture:g} (m), as agreed to"
        )
    for finding in preview(following).findings:
        if finding.severity == "error":
            raise InvalidInput(finding.field, finding.message, finding.allowed or "a plan without errors")


def _propose(path: Path, stage: FocusStage, planner: StagePlanner, control: SessionControl) -> tuple[Proposal, ...]:
    """Return the proposals of a stage; none where the A-lines are too few for an image."""
    try:
        return _compute(lambda: planner.propose(path, stage), planner, control)
    except InvalidInput as error:
        _log.warning("no point of interest is proposed: %s", error)
        return ()


def _decide(
    control: SessionControl, number: int, stage: FocusStage, proposals: tuple[Proposal, ...], began: float
) -> tuple[Points, str]:
    """Return the points of interest of a stage and the author of the decision, after waiting for a person if needed."""
    control.on_proposals(number, proposals)
    by_rule = tuple(each.position for each in proposals) if stage.decision == "auto" else ()
    waiting = False
    while True:
        decision = control.decide(number, by_rule)
        late = by_rule and time.monotonic() - began > LONGEST_AUTOMATIC
        if decision is not None and not (late and decision[1] == BY_RULE):
            return decision
        if late:
            raise ScanInterrupted(f"stage {number} was not decided within {LONGEST_AUTOMATIC:g} s; resume the scan")
        if not control.can_ask:
            found = f"{len(proposals)} proposed" if proposals else "nothing stands above the noise"
            raise ScanInterrupted(f"stage {number} needs a point of interest ({found}); choose one and resume the scan")
        if not (waiting or by_rule):
            waiting = True
            control.on_phase(SessionPhase.DECIDING)
        if (wish := control.command()) in TERMINAL_COMMANDS:
            raise _Ended(wish)
        control.wait(POLL)


def _compute(call: Callable[[], _T], planner: StagePlanner, control: SessionControl) -> _T:
    """Return the result of a long call; a command that ends the session abandons it."""
    results: list[_T] = []
    errors: list[Exception] = []

    def work() -> None:
        try:
            results.append(call())
        except Exception as error:
            errors.append(error)

    thread = threading.Thread(target=work, name="stage", daemon=True)
    thread.start()
    while thread.is_alive():
        if (wish := control.command()) in TERMINAL_COMMANDS:
            planner.cancel()
            thread.join()
            raise _Ended(wish)
        thread.join(POLL)
    if errors:
        if isinstance(errors[0], SteradianError):
            raise errors[0]
        raise ScanInterrupted(f"the next stage cannot be computed: {errors[0]}; resume the scan") from errors[0]
    return results[0]


def _count_stages(path: Path) -> int:
    return len(read_stages(path)) or 1
