"""Query parameters that filter list endpoints, and the check that rejects unknown parameters."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from fastapi import Query, Request
from fastapi.dependencies.models import Dependant
from fastapi.exceptions import RequestValidationError
from pydantic import StringConstraints

from steradian.jobs.registry import JOB_TYPES, VOLUME_KINDS
from steradian.masks import ARRANGEMENTS
from steradian.storage.repositories.filters import Label
from steradian.storage.state_machines import BatchState, ReconstructionState, ScanState

MOST_LABELS = 10


def _one(what: str, example: str) -> Any:
    return Query(max_length=64, description=f"Only {what}", examples=[example])


_STATES: Any = Query(description="Only in this state, or in one of these states")
ScanStates: TypeAlias = Annotated[list[ScanState] | None, _STATES]
JobStates: TypeAlias = Annotated[list[ReconstructionState] | None, _STATES]
BatchStates: TypeAlias = Annotated[list[BatchState] | None, _STATES]
Labels: TypeAlias = Annotated[
    list[Annotated[str, StringConstraints(pattern="^[^=]", max_length=261)]] | None,
    Query(
        max_length=MOST_LABELS,
        description="Only with this label: NAME, or NAME=TEXT; several: with all of them",
        examples=[["phantom=yarn"]],
    ),
]
if TYPE_CHECKING:
    ArrangementName: TypeAlias = str
    _Kind: TypeAlias = str
    _VolumeKind: TypeAlias = str
else:
    ArrangementName = Literal[ARRANGEMENTS]
    _Kind = Literal[tuple(JOB_TYPES)]
    _VolumeKind = Literal[VOLUME_KINDS]
ArrangementFilter: TypeAlias = Annotated[ArrangementName | None, Query(description="Only of this kind")]
MaskIdFilter: TypeAlias = Annotated[str | None, _one("of this mask", "m0123456789abcdef01234567")]
ThroughMaskIdFilter: TypeAlias = Annotated[
    str | None, _one("of what this mask measured, or what-if would have", "m0123456789abcdef01234567")
]
PlanIdFilter: TypeAlias = Annotated[str | None, _one("of this plan", "p0123456789abcdef01234567")]
ScanIdFilter: TypeAlias = Annotated[str | None, _one("of this scan", "s01jz0000000000000000000000")]
BatchIdFilter: TypeAlias = Annotated[str | None, _one("of this batch", "b01jz0000000000000000000000")]
JobKind: TypeAlias = Annotated[_Kind | None, Query(description="Only this kind")]
VolumeKind: TypeAlias = Annotated[_VolumeKind | None, Query(description="Only this kind")]


def parse_labels(labels: list[str] | None) -> list[Label]:
    """Parse ``key=value`` label filters; the key ends at the first equals sign."""
    parted = (label.partition("=") for label in labels or ())
    return [(name, text if equals else None) for name, equals, text in parted]


def reject_unknown_query_params(request: Request, dependant: Dependant) -> None:
    """Reject a request that has query parameters the operation does not declare.

    Raises
    ------
    RequestValidationError
        With the names of the declared parameters.
    """
    if not request.query_params:
        return
    known = list(_names(dependant))
    unknown = [name for name in request.query_params if name not in known]
    if unknown:
        about = {"expected": ", ".join(known) or "none"}
        raise RequestValidationError(
            [{"type": "unknown_query", "loc": ("query", name), "msg": "", "ctx": about} for name in unknown]
        )


def _names(dependant: Dependant) -> Iterator[str]:
    yield from (parameter.alias for parameter in dependant.query_params)
    for inner in dependant.dependencies:
        yield from _names(inner)
