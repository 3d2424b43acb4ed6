"""Output of responses as tables or JSON, and of progress on standard error."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from typing import Annotated, Any, TypeAlias

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Table

from steradian_client.models import ResponseModel
from steradian_client.polling import Report

AsJson: TypeAlias = Annotated[bool, typer.Option("--json", help="Print the answer as JSON.")]
Settings: TypeAlias = Annotated[
    list[str] | None, typer.Argument(metavar="[NAME=VALUE]...", help="Parameters; values as in JSON, or plain text.")
]
Timeout: TypeAlias = Annotated[float | None, typer.Option(help="Maximum time to wait (s); the job continues.")]


def settings(pairs: Sequence[str] | None) -> dict[str, Any]:
    """Parse ``name=value`` pairs into a dictionary; a value that is not JSON is a string."""
    found: dict[str, Any] = {}
    for pair in pairs or ():
        name, equals, text = pair.partition("=")
        if not equals or not name:
            raise typer.BadParameter(f"{pair!r} is not of the form NAME=VALUE")
        try:
            found[name.replace("-", "_")] = json.loads(text)
        except ValueError:
            found[name.replace("-", "_")] = text
    return found


def print_item(answer: ResponseModel, as_json: bool) -> None:
    """Print one response, as a table of its fields or as JSON."""
    if as_json:
        print(answer.model_dump_json(indent=2))
        return
    table = Table(show_header=False, box=None)
    for name, value in answer.model_dump().items():
        if name != "links" and value not in (None, {}, []):
            table.add_row(name, _text(value))
    Console().print(table)


def print_table(answers: Sequence[ResponseModel], columns: Sequence[str], as_json: bool) -> None:
    """Print several responses, as a table of the given columns or as JSON."""
    if as_json:
        print(json.dumps([answer.model_dump(mode="json") for answer in answers], indent=2))
        return
    table, rows = Table(box=None), [[_text(getattr(answer, name, None)) for name in columns] for answer in answers]
    for name, texts in zip(columns, zip(*rows, strict=True) if rows else [()] * len(columns), strict=True):
        whole = max(map(len, texts), default=0) if name == "id" else None  # it is what the next command is given
        table.add_column(name, min_width=whole)
    for row in rows:
        table.add_row(*row)
    Console().print(table)


@contextmanager
def progress_reporter() -> Iterator[Report]:
    """Show progress on standard error: a bar at a terminal, a line for each stage elsewhere."""
    console = Console(stderr=True)
    if not console.is_terminal:
        said: set[str] = set()

        def say(stage: str, done: int, total: int) -> None:
            if stage not in said:
                said.add(stage)
                print(f"{stage} …", file=sys.stderr)

        yield say
        return
    tasks: dict[str, TaskID] = {}
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as bars:

        def advance(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage)
            bars.update(tasks[stage], completed=done, total=total or None)

        yield advance


def _text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, datetime):
        return f"{value:%Y-%m-%d %H:%M:%S}"
    if isinstance(value, ResponseModel):
        return ", ".join(_text(part) for part in value.model_dump().values() if part is not None)
    if isinstance(value, dict | list):
        text = json.dumps(value, default=str)
        return text if len(text) <= 200 else f"{text[:200]} …"
    return f"{value:g}" if isinstance(value, float) else str(value)
