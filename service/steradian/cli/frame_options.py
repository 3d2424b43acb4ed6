"""Typer options that select frames of a scan."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

import typer

from steradian.cli.console import length, quantity_option

if TYPE_CHECKING:
    from steradian.scans.frames import FrameChoice

PANEL = "Which frames of a scan that has several"
FrameOption: TypeAlias = Annotated[
    int | None, typer.Option(help="One frame, from 0; default: the first, with a note.", rich_help_panel=PANEL)
]
WavelengthOption: TypeAlias = Annotated[
    float | None,
    quantity_option(length, help="The first frame at this excitation wavelength, 750nm.", rich_help_panel=PANEL),
]
AverageOption: TypeAlias = Annotated[
    bool,
    typer.Option("--average", help="The mean of all frames, or of those at the wavelength.", rich_help_panel=PANEL),
]
EachOption: TypeAlias = Annotated[
    Literal["frame", "wavelength"] | None,
    typer.Option(help="All, each into a folder of its own; with --average the mean at each.", rich_help_panel=PANEL),
]


def each_choice(file: Path, each: Literal["frame", "wavelength"], average: bool) -> dict[str, FrameChoice]:
    """Return one frame selection for each frame or excitation wavelength of a scan file, keyed by folder name.

    With ``average`` the mean at each wavelength.
    """
    from steradian.scans.file.read import list_frames
    from steradian.scans.frames import FrameChoice, distinct_wavelengths

    frames = list_frames(file)
    if each == "frame":
        return {f"frame-{one.index}": FrameChoice(one.index) for one in frames}
    return {
        f"{1e9 * light:g}nm" if light else "not-stated": FrameChoice(wavelength=light, average=average)
        for light in distinct_wavelengths(frames)
    }
