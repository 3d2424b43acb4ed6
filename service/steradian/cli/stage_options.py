"""Options of the commands for scans in stages: ``--survey``, ``--focus`` and ``--enough``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from steradian.cli.console import length
from steradian.core.choices import VisitOrder
from steradian.core.exceptions import InvalidInput

if TYPE_CHECKING:
    from steradian.plans import ScanPlan
    from steradian.plans.stages import Points, Proposal

STAGES = "Stages"
ALLOWED = "auto, nearest, several:N, ask, or a place such as 2.6mm,-1.8mm,2mm (x, y, depth)"
SurveyOption: TypeAlias = Annotated[
    int | None,
    typer.Option(
        metavar="POINTS",
        help="Measure in stages: first so many evenly spread points, then the rest of the plan's number focused on what"
        " they show.",
        rich_help_panel=STAGES,
    ),
]
FocusOption: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        metavar="RULE|PLACE",
        help="Points of interest of the focus: auto (the brightest place), nearest (to the film), several:3 (the"
        " brightest three), ask (the laser rests until one is chosen), or a place as x,y,depth, e.g."
        " 2.6mm,-1.8mm,2mm; several places by repetition. [default: auto]",
        rich_help_panel=STAGES,
    ),
]
EnoughOption: TypeAlias = Annotated[
    float | None,
    typer.Option(
        metavar="GAIN",
        help="End the scan early, from half of the points on, where the rest is expected to raise the image's"
        " correlation with the object by no more than this, e.g. 0.004. The order is then progressive.",
        rich_help_panel=STAGES,
    ),
]


def plan_with_stages(plan: ScanPlan, survey: int | None, focus: list[str] | None, enough: float | None) -> ScanPlan:
    """Return a plan with the stages and the stopping rule of the options.

    Raises
    ------
    InvalidInput
        Naming the option, its text and what is allowed.
    """
    from steradian.plans.next_stage import plan_in_stages
    from steradian.plans.stages import FEWEST_POINTS, FocusStage, StoppingRule

    if enough is not None:
        plan = plan.replace(stopping=StoppingRule.create(max_gain=enough), order=VisitOrder.PROGRESSIVE)
    if survey is None:
        if not focus:
            return plan
        if not plan.stages:
            raise InvalidInput("focus", ", ".join(focus), "only with --survey, or with a plan in stages")
        first, *others = plan.stages
        kept = {"points": first.points, "least_signal_to_noise": first.least_signal_to_noise}
        return plan.replace(stages=(FocusStage.create(**kept, **parse_focus(focus)), *others))
    rule = FocusStage.create(points=FEWEST_POINTS, **parse_focus(focus))
    return plan_in_stages(plan, survey, focus=rule, stopping=plan.stopping)


def parse_focus(focus: list[str] | None) -> dict[str, object]:
    """Return the fields of a :class:`~steradian.plans.stages.FocusStage` that the option ``--focus`` says."""
    said = focus or ["auto"]
    places = parse_places(said)
    if places:
        return {"points_of_interest": places}
    if len(said) > 1:
        raise InvalidInput("focus", ", ".join(said), ALLOWED)
    name, _, number = said[0].partition(":")
    match name, number:
        case (("auto" | "ask"), ""):
            return {"decision": name}
        case "nearest", "":
            return {"choice": "nearest"}
        case "several", _ if number.isdecimal():
            return {"choice": "several", "count": int(number)}
    raise InvalidInput("focus", said[0], ALLOWED)


def parse_places(said: list[str]) -> Points:
    """Return places (x, y, depth in m) from texts such as ``2.6mm,-1.8mm,2mm``; empty where none is one.

    Raises
    ------
    InvalidInput
        When only some are places, or a coordinate is not a length.
    """
    if not any("," in text for text in said):
        return ()
    places = []
    for text in said:
        parts = text.split(",")
        if len(parts) != 3:
            raise InvalidInput("focus", text, ALLOWED)
        try:
            x, y, depth = (float(length(part.strip())) for part in parts)
        except (typer.BadParameter, ValueError) as error:
            raise InvalidInput("focus", text, ALLOWED) from error
        places.append((x, y, depth))
    return tuple(places)


def parse_choice(said: str, proposals: tuple[Proposal, ...]) -> Points:
    """Return points of interest from a typed answer: numbers of proposals, or a place.

    Raises
    ------
    InvalidInput
        Naming the answer and what is allowed.
    """
    numbers = [part.strip() for part in said.split(",")]
    if said and all(number.isdecimal() for number in numbers):
        wrong = [number for number in numbers if not 1 <= int(number) <= len(proposals)]
        if wrong:
            raise InvalidInput(
                "choice", wrong[0], f"1 to {len(proposals)}" if proposals else "a place: none is proposed"
            )
        return tuple(proposals[int(number) - 1].position for number in numbers)
    places = parse_places([said])
    if not places:
        raise InvalidInput("choice", said, "numbers such as 1 or 1,2, or a place such as 2.6mm,-1.8mm,2mm")
    return places


def describe_proposal(proposal: Proposal) -> str:
    """Return a proposal as text: its place in mm, its signal-to-noise and the promise of a focus there."""
    x, y, depth = (1e3 * value for value in proposal.position)
    sharp = ""
    if {"lateral_m", "true_m"} <= set(proposal.promise):
        wide, true = (1e6 * proposal.promise[name] for name in ("lateral_m", "true_m"))
        sharp = f"; focused there, a ball of {true:.0f} µm is {wide:.0f} µm wide in the image"
    return f"x {x:.2f} mm, y {y:.2f} mm, depth {depth:.2f} mm, signal-to-noise {proposal.signal_to_noise:.0f}{sharp}"
