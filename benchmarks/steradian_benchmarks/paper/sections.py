"""Data classes of the sections and claims of the paper's benchmark.

To add one, write a module in this package with a ``SECTION`` and put the module's name into ``NAMES``, in the order of
the page. ``measure`` returns plain JSON values; ``write`` turns exactly those into Markdown, so that no figure on the
page can be typed by hand.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from statistics import mean, stdev
from typing import Any, TypeAlias

from steradian.core.exceptions import InvalidInput

SectionResult: TypeAlias = dict[str, Any]
"""What a section measured: JSON values only (str, int, float, bool, None, lists and dicts of them)."""

SECTION_NAMES = ("resolution", "tree", "yarn", "iterative", "focus")
"""Modules of this package, in the order of the page."""


@dataclass(frozen=True, slots=True)
class SectionContext:
    """Context of a section's measurements: output folder, progress and options.

    Parameters
    ----------
    quick
        Small versions of everything: whether it runs, no measurement.
    folder
        Where pictures go, as PNG files; it exists.
    step
        Call as ``step(done, total)`` between pieces of work; raises ``Cancelled`` when the benchmark is cancelled.
    """

    quick: bool
    folder: Path
    step: Callable[[int, int], None]

    def picture(self, name: str) -> Path:
        """Return the path of a picture file; :func:`.markdown.picture` embeds the picture in the page."""
        return self.folder / f"{name}.png"


@dataclass(frozen=True, slots=True)
class Section:
    """Section of the benchmark page: name, title, and its functions measure, write and claims.

    Parameters
    ----------
    name
        Its key in the JSON document and its name for ``--only``.
    title
        Its heading on the page.
    measure
        Does the work.
    write
        Markdown below the heading, from what ``measure`` returned; a pure function.
    claims
        Short statements for the top of the page and whether they held, from what ``measure`` returned.
    """

    name: str
    title: str
    measure: Callable[[SectionContext], SectionResult]
    write: Callable[[SectionResult], str]
    claims: Callable[[SectionResult], list[Claim]] = lambda part: []


class Verdict(StrEnum):
    """Verdict on a claim, determined by :data:`RULE`."""

    HOLDS = "yes"
    SIGN = "sign only"
    FAILS = "no"


RULE = (
    "*Holds*, one rule for all lines: **no** if any run has the other sign or misses the stated limit; *yes* if none\n"
    "does and the paper's figure, where there is one, is at most one standard deviation above the mean of our runs;\n"
    "*sign only* between."
)
"""The rule of :attr:`Claim.verdict` in words."""


@dataclass(frozen=True, slots=True)
class Claim:
    """Claim of the paper with its measured margins: one line of the summary at the top of the page.

    Parameters
    ----------
    text
        What the paper, or this project, says.
    runs
        What each run gave, such that above zero bears it out; a single measurement gives its value minus and plus its
        standard error.
    ours, paper
        Both figures, as text; empty where there is none.
    figure
        The paper's, in the unit of ``runs``; None where it has none.
    headline
        Whether the README shows it too.
    """

    text: str
    runs: tuple[float, ...]
    ours: str
    paper: str = ""
    figure: float | None = None
    headline: bool = False

    @property
    def verdict(self) -> Verdict:
        """Verdict of the measured runs on the claim, according to :data:`RULE`."""
        if min(self.runs) <= 0:
            return Verdict.FAILS
        deviation = stdev(self.runs) if len(self.runs) > 1 else 0.0
        if self.figure is not None and self.figure > mean(self.runs) + deviation:
            return Verdict.SIGN
        return Verdict.HOLDS


def sections(only: tuple[str, ...] = ()) -> list[Section]:
    """Return all sections, or the named ones, in the order of the page.

    Raises
    ------
    InvalidInput
        When a name is unknown.
    """
    for name in only:
        if name not in SECTION_NAMES:
            raise InvalidInput("only", name, ", ".join(SECTION_NAMES))
    chosen = [name for name in SECTION_NAMES if not only or name in only]
    found: list[Section] = [importlib.import_module(f"{__package__}.{name}").SECTION for name in chosen]
    return found
