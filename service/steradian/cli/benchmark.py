"""``steradian benchmark``: figures measured on this machine, each beside a yardstick of the same run."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from steradian import __version__
from steradian.cli.console import console, progress_bar

app = typer.Typer(
    help="Measure this installation; prints a table and, with --json, writes it to a file.", no_args_is_help=True
)

Row = dict[str, Any]
JsonFile = Annotated[Path | None, typer.Option("--json", help="Also write the figures to this file.")]


@app.command()
def speed(
    json_file: JsonFile = None,
    repeats: Annotated[int, typer.Option(help="Runs of each case; the median counts.", min=1)] = 5,
    quick: Annotated[bool, typer.Option(help="Small versions of all cases: whether they run, no measurement.")] = False,
) -> None:
    """Time reconstructions in units of the bare FFTs of their volume (scipy rfftn + irfftn, float32, same run).

    'ratio' is ours over the yardstick and 'limit' what it must not exceed; plan and run are timed apart.
    'ned_s' is our non-uniform FFT over the sensors alone and 'finufft_s' FINUFFT's at its best setting.
    """
    from steradian.benchmarks.speed import speed as measure

    with progress_bar() as progress:
        rows = measure(quick=quick, repeats=repeats, progress=progress)
    _publish("speed", rows, json_file)


@app.command()
def accuracy(json_file: JsonFile = None) -> None:
    """Compare the image's spectrum with direct float64 sums, per tolerance, method and size (relative l2 error)."""
    from steradian.benchmarks.accuracy import accuracy as measure

    with progress_bar() as progress:
        rows = measure(progress=progress)
    _publish("accuracy", rows, json_file)


@app.command()
def masks(json_file: JsonFile = None) -> None:
    """Time masks and orders of visit, with the length of the way and the evenness of the solid angles."""
    from steradian.benchmarks.masks import masks as measure

    with progress_bar() as progress:
        rows = measure(progress=progress)
    _publish("masks", rows, json_file)


@app.command()
def link(json_file: JsonFile = None) -> None:
    """Time the scanner's link: A-lines decoded per second beside the raw rate, and stored durably under full load."""
    from steradian.benchmarks.link import link as measure

    with progress_bar() as progress:
        rows = measure(progress=progress)
    _publish("link", rows, json_file)


def _publish(name: str, rows: list[Row], path: Path | None) -> None:
    """Print rows as a table and write them, with what they were measured on, to ``path``."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    table = Table(title=name, title_justify="left", box=None, pad_edge=False)
    for column in columns:
        table.add_column(column.replace("_", " "), justify="left" if _is_text(rows, column) else "right")
    for row in rows:
        table.add_row(*(_shown(row.get(column)) for column in columns))
    console().print(table)
    if path is None:
        return
    machine = {"cpus": os.cpu_count(), "system": platform.platform(), "python": platform.python_version()}
    document = {
        "benchmark": name,
        "measured": datetime.now(UTC).isoformat(timespec="seconds"),
        "software": f"steradian {__version__}",
        "machine": machine,
        "rows": rows,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")


def _is_text(rows: Iterable[Row], column: str) -> bool:
    return any(isinstance(row.get(column), str) for row in rows)


def _shown(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.3g}" if isinstance(value, float) else str(value)
