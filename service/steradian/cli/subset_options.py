"""Options of ``reconstruct`` for standard errors and suppressed artefacts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from steradian.core.exceptions import InvalidInput

if TYPE_CHECKING:
    from steradian.reconstructions.pipeline.sensor_subsets import SubsetOptions

PANEL = "Errors and artefacts of direct images"
UncertaintyOption: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--uncertainty",
        help="Also write the standard error of each voxel, uncertainty.h5, at the cost of eight images.",
        rich_help_panel=PANEL,
    ),
]
SuppressOption: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--suppress-artefacts",
        help="Suppress what images of two halves of the sensors do not share; for looking, not for measuring.",
        rich_help_panel=PANEL,
    ),
]


def parse_subsets(uncertainty: bool, suppress_artefacts: bool, *, follow: bool) -> SubsetOptions:
    """Return the options; raise :class:`InvalidInput` where a scan is followed."""
    from steradian.reconstructions.pipeline.sensor_subsets import SubsetOptions

    for name, wanted in (("uncertainty", uncertainty), ("suppress_artefacts", suppress_artefacts)):
        if wanted and follow:
            raise InvalidInput(name, "true", "without follow")
    return SubsetOptions(uncertainty, suppress_artefacts)


def refuse_series(subsets: SubsetOptions) -> None:
    """Raise :class:`InvalidInput` if options of one image were given for a series."""
    for name in ("uncertainty", "suppress_artefacts"):
        if getattr(subsets, name):
            raise InvalidInput(name, "true", "one image: with a frame, or the average of one wavelength")
