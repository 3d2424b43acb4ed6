"""Planner of stages in a child process, beside a running scan."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, ParamSpec, Self, TypeVar

import numpy as np

from steradian.core.child_process import CallProcess, ChildExited
from steradian.core.exceptions import Cancelled, ScanInterrupted
from steradian.plans import ScanPlan
from steradian.plans.stages import FEWEST_POINTS, FocusStage, Points, Proposal

if TYPE_CHECKING:
    from steradian.masks import Mask

WARM_UP_APERTURE = 5e-3

_P = ParamSpec("_P")
_T = TypeVar("_T")


def propose(path: Path, stage: FocusStage) -> tuple[Proposal, ...]:
    """Return points of interest found in the image of a scan file's A-lines, by the rule of a stage.

    Raises
    ------
    DamagedFile
        When the file cannot be read or holds no A-line.
    """
    from steradian.masks.expected_focus import expected_focus
    from steradian.reconstructions.scan_plan_reader import read_stored_plan
    from steradian.reconstructions.stages.survey_image import find_in_scan

    found = find_in_scan(
        path, choice=stage.choice, count=stage.count, least_signal_to_noise=stage.least_signal_to_noise
    )
    if not found:
        return ()
    plan = read_stored_plan(path).plan
    focused = _extended(plan.mask, tuple(each.position for each in found), stage.points)
    return tuple(
        Proposal(
            position=each.position,
            signal_to_noise=each.signal_to_noise,
            promise=asdict(expected_focus(focused, each.position, sound_speed=plan.sound_speed)),
        )
        for each in found
    )


def judge(path: Path, plan: ScanPlan) -> str:
    """Return why a scan has enough points; see :func:`.enough.judge`."""
    from steradian.reconstructions.stages.enough import judge as judge_images

    return judge_images(path, plan)


def next_plan(plan: ScanPlan, points: Points) -> ScanPlan:
    """Return the plan of the next stage around points of interest (x, y, depth in m); the visit order is computed.

    Raises
    ------
    InvalidInput
        When a point of interest is not over the aperture.
    """
    from steradian.plans.next_stage import plan_of_next_stage

    following = plan_of_next_stage(plan, _extended(plan.mask, points, plan.stages[0].points))
    following.tuned_order  # noqa: B018 - computed here, not in the process that runs the scanner
    return following


_LATEST: dict[tuple[str, Points, int], Mask] = {}
"""The latest extended mask: the plan of a stage usually takes the proposal whose mask was computed just before."""


def _extended(mask: Mask, points: Points, further: int) -> Mask:
    from steradian.masks.staged import extend_mask

    key = mask.id, points, further
    if key not in _LATEST:
        _LATEST.clear()
        _LATEST[key] = extend_mask(mask, points, further)
    return _LATEST[key]


def warm_up() -> None:
    """Load the modules and compiled functions that a proposal and a mask need, with A-lines of noise."""
    from steradian.imaging import Acquisition, ImageGrid, Nufft, reconstruct
    from steradian.masks.staged import extend_mask, survey_mask
    from steradian.plans import progressive
    from steradian.quality.points_of_interest import find_points_of_interest

    mask = survey_mask(WARM_UP_APERTURE, 2 * FEWEST_POINTS)
    traces = np.random.default_rng(0).standard_normal((mask.count, 64), np.float32)
    acquisition = Acquisition(traces, mask.positions, dt=40e-9, sound_speed=1500.0, aperture=mask.aperture)
    volume = reconstruct(acquisition, ImageGrid(modes=16), Nufft())
    find_points_of_interest(volume, halves=(volume, volume))
    progressive(extend_mask(mask, ((0.0, 0.0, 1e-3),), 4 * FEWEST_POINTS).positions)


class ChildStagePlanner:
    """Planner of stages whose computations run in a child process, one after another.

    The process is started at once and loads what it needs while the scanner measures the survey; one that was killed is
    started again. :meth:`close` ends it.
    """

    def __init__(self) -> None:
        self._child = CallProcess()
        self._turn = threading.Lock()
        self._closed = threading.Event()
        threading.Thread(target=self._warm_up, name="stage-planner", daemon=True).start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def propose(self, path: Path, stage: FocusStage) -> tuple[Proposal, ...]:
        """Return points of interest; see :func:`propose`."""
        return self._call(propose, path, stage)

    def next_plan(self, plan: ScanPlan, points: Points) -> ScanPlan:
        """Return the plan of the next stage; see :func:`next_plan`."""
        return self._call(next_plan, plan, points)

    def enough(self, path: Path, plan: ScanPlan) -> str:
        """Return why a scan has enough points; see :func:`.enough.judge`."""
        return self._call(judge, path, plan)

    def cancel(self) -> None:
        """End the child process; a call in progress raises ``Cancelled``."""
        self._closed.set()
        self._child.kill()

    def close(self) -> None:
        """End the child process and wait for its end."""
        self.cancel()
        with self._turn:
            self._child.end()

    def _warm_up(self) -> None:
        with suppress(Exception):  # a proposal tells whether something is wrong
            self._call(warm_up)

    def _call(self, function: Callable[_P, _T], *args: _P.args, **options: _P.kwargs) -> _T:
        with self._turn:
            for tries_left in (1, 0):
                try:
                    return self._child.call(function, *args, **options)
                except ChildExited as error:
                    if self._closed.is_set():
                        raise Cancelled("the next stage is not computed: the scan ends") from error
                    if not tries_left:
                        raise ScanInterrupted(f"the next stage is not computed ({error}); resume") from error
                    self._child.end()
                    self._child = CallProcess()
                    if self._closed.is_set():  # meanwhile
                        self._child.kill()
            raise AssertionError
