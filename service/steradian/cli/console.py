"""What the commands share: units, tables, progress bars, one-line errors."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bars
from rich.table import Table

from steradian.progress import Progress

PREFIXES = {"n": 1e-9, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "m": 1e-3, "c": 1e-2, "k": 1e3, "M": 1e6, "": 1.0}


def _parser(unit: str) -> Callable[[str | float], float]:
    """Make a parser of numbers with an optional unit, such as ``13.56mm``; a bare number is in the base unit."""

    def parse(value: str | float) -> float:
        match = re.fullmatch(rf"\s*([-+0-9.eE]+)\s*(?:([nuµμmckM]?){unit})?\s*", str(value))
        try:
            if match:
                return float(match[1]) * PREFIXES[match[2] or ""]
        except ValueError:
            pass
        raise typer.BadParameter(f"{value!r} is no number of {unit}, such as 1.5 or 1.5m{unit}")

    parse.__name__ = f"number of {unit}"
    return parse


length, duration, frequency = _parser("m"), _parser("s"), _parser("Hz")


def console() -> Console:
    """Make a console on standard output; in a file or pipe tables have room for their columns."""
    roomy = not sys.stdout.isatty() and "COLUMNS" not in os.environ
    return Console(highlight=False, width=180 if roomy else None)


def complain(message: str) -> None:
    """Write one error line to standard error."""
    Console(stderr=True, highlight=False, soft_wrap=True).print(f"[bold red]error:[/] {_plain(message)}")


def show_figures(title: str, figures: Mapping[str, object]) -> None:
    """Print names and values in two columns."""
    table = Table(title=title, title_justify="left", title_style="bold", show_header=False, box=None, pad_edge=False)
    table.add_column(style="cyan", no_wrap=True)
    table.add_column()
    for name, value in figures.items():
        table.add_row(name, _plain(str(value)))
    console().print(table, "")


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """Show a bar per stage on standard error, where that is a terminal."""
    columns = (TextColumn("{task.description:<24}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    target = Console(stderr=True)
    with Bars(*columns, console=target, transient=True, disable=not target.is_terminal) as bars:
        stages: dict[str, TaskID] = {}

        def report(stage: str, done: int, total: int) -> None:
            if stage not in stages:
                stages[stage] = bars.add_task(stage, total=total)
            bars.update(stages[stage], completed=done, total=total)

        yield report


def _plain(text: str) -> str:
    """Keep square brackets in messages from being read as markup."""
    return text.replace("[", r"\[")
