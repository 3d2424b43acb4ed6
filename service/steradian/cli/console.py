"""Shared output of the commands: units, tables, progress bars, one-line errors."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bars
from rich.table import Table

PREFIXES = {"n": 1e-9, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "m": 1e-3, "c": 1e-2, "k": 1e3, "M": 1e6, "": 1.0}


Quantity: TypeAlias = Callable[[str | float], float]
"""Reads a number with an optional unit, such as ``13.56mm``; a bare number is in the base unit."""


def _parser(kind: str, unit: str) -> Quantity:
    """Create the typer parser of a quantity with a unit, for example ``1.5mm``; help shows the quantity's name."""

    def parse(value: str | float) -> float:
        match = re.fullmatch(rf"\s*([-+0-9.eE]+)\s*(?:([nuµμmckM]?){unit})?\s*", str(value))
        try:
            if match:
                return float(match[1]) * PREFIXES[match[2] or ""]
        except ValueError:
            pass
        raise typer.BadParameter(f"{value!r} is not a number of {unit}, for example 1.5 or 1.5m{unit}")

    parse.__name__ = kind
    return parse


length, duration = _parser("length", "m"), _parser("time", "s")
frequency, speed = _parser("frequency", "Hz"), _parser("speed", "m/s")


def quantity_option(kind: Quantity, default: str | None = None, *names: str, **more: Any) -> Any:
    """Create a typer option for a quantity with a unit; ``default`` is the text that help shows as default."""
    return typer.Option(*names, parser=kind, metavar=f"<{kind.__name__}>", show_default=default or True, **more)


def plot_option(help: str) -> Any:
    """Create the typer option ``--plot`` for a figure file, whose ending is validated before the command runs."""
    return typer.Option(help=help, callback=_checked_picture)


def _checked_picture(path: Path | None) -> Path | None:
    if path is not None:
        from steradian.drawing.mpl_style import check_suffix

        check_suffix(path, "plot")
    return path


def console() -> Console:
    """Create a rich console on standard output, wide enough for tables when the output is a file or pipe."""
    roomy = not sys.stdout.isatty() and "COLUMNS" not in os.environ
    return Console(highlight=False, width=180 if roomy else None)


def print_error(message: str) -> None:
    """Print one error line to standard error."""
    Console(stderr=True, highlight=False, soft_wrap=True).print(f"[bold red]error:[/] {_plain(message)}")


def print_stderr(line: str) -> None:
    """Print one line to standard error without formatting."""
    Console(stderr=True, highlight=False, soft_wrap=True).print(_plain(line))


def show_figures(title: str, figures: Mapping[str, object]) -> None:
    """Print names and values as a table of two columns."""
    table = Table(title=title, title_justify="left", title_style="bold", show_header=False, box=None, pad_edge=False)
    table.add_column(style="cyan", no_wrap=True)
    table.add_column()
    for name, value in figures.items():
        table.add_row(name, _plain(str(value)))
    console().print(table, "")


class ProgressBar:
    """Progress bars on the terminal, one for each stage; callable as :data:`steradian.core.progress.Progress`.

    Parameters
    ----------
    bars
        Where they are drawn.
    """

    def __init__(self, bars: Bars) -> None:
        self._bars = bars
        self._stages: dict[str, TaskID] = {}

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Update the progress bar of a stage; the part of the stage's name after a comma is variable text."""
        name = stage.partition(",")[0]
        if name not in self._stages:
            self._stages[name] = self._bars.add_task(stage, total=total)
        self._bars.update(self._stages[name], description=stage, completed=done, total=total)

    def say(self, line: str) -> None:
        """Print a line above the progress bars; thread-safe."""
        self._bars.console.print(_plain(line), soft_wrap=True)


def show_notes(notes: Iterable[str]) -> None:
    """Print notes that affect the interpretation of a result."""
    for note in notes:
        console().print(f"[yellow]note[/]: {note}", soft_wrap=True)


@contextmanager
def progress_bar() -> Iterator[ProgressBar]:
    """Show progress bars on standard error during the block, if standard error is a terminal."""
    columns = (TextColumn("{task.description:<24}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    target = Console(stderr=True, highlight=False)
    with Bars(*columns, console=target, transient=True, disable=not target.is_terminal) as bars:
        yield ProgressBar(bars)


def format_files(folder: Path) -> str:
    """Return the names of the files in a folder, separated by commas."""
    return ", ".join(sorted(path.name for path in folder.iterdir()))


def finish_with_summary(*results: tuple[str, Path | None]) -> None:
    """Print the last line of a command: the output files with their sizes.

    Parameters
    ----------
    results
        What was made, and its file or folder; without one it is left out.
    """
    said = [f"{what} in {path_with_size(path)}" for what, path in results if path is not None]
    console().print(_plain("; ".join(said)), soft_wrap=True)


def path_with_size(path: Path) -> str:
    """Return a path with the size of its file or folder, as in ``scan.h5 (4.3 MB)``."""
    if not path.is_dir():
        return f"{path} ({human_size(path.stat().st_size)})"
    files = [file for file in path.rglob("*") if file.is_file()]
    total = human_size(sum(file.stat().st_size for file in files))
    return f"{path} ({len(files)} file{'' if len(files) == 1 else 's'}, {total})"


def human_size(count: float) -> str:
    """Format a number of bytes with a decimal prefix and three digits."""
    for unit in ("B", "kB", "MB", "GB"):
        if count < 999.5:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.3g} TB"


def _plain(text: str) -> str:
    """Escape square brackets in a message, which rich would read as markup."""
    return text.replace("[", r"\[")
