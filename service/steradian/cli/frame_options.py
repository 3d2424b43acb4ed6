"""Typer options that select frames of a scan."""

from __future__ import annotations

from typing import Annotated, TypeAlias

import typer

from steradian.cli.console import length, quantity_option

PANEL = "Which frames of a scan that has several"
FrameOption: TypeAlias = Annotated[
    int | None,
    typer.Option(
        help="One frame, from 0; default: reconstruct makes a series of all, others take the first, with a note.",
        rich_help_panel=PANEL,
    ),
]
WavelengthOption: TypeAlias = Annotated[
    float | None,
    quantity_option(length, help="The frames at this excitation wavelength, 750nm.", rich_help_panel=PANEL),
]
AverageOption: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--average", help="The mean of the frames, for a series of those at each wavelength.", rich_help_panel=PANEL
    ),
]
MOTION = "Motion of the object"
AlignOption: TypeAlias = Annotated[
    bool,
    typer.Option("--align", help="Undo shifts of the object between the volumes of a series.", rich_help_panel=MOTION),
]
MotionOption: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--motion",
        help="Undo motion of the object within a scan, whose shots must be in progressive order or alike.",
        rich_help_panel=MOTION,
    ),
]
