"""Output of benchmark rows as a table and as JSON."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import typer
from rich.table import Table

from steradian.benchmarks.report_pages import with_environment
from steradian.cli.console import console, finish_with_summary

Row = dict[str, Any]
JsonFile: TypeAlias = Annotated[Path | None, typer.Option("--json", help="Also write the figures to this file.")]


def print_and_save(name: str, rows: list[Row], path: Path | None, columns: Sequence[str] = ()) -> None:
    """Print ``columns`` of the rows as a table (all if empty), and write all rows to ``path`` as JSON."""
    columns = columns or list(dict.fromkeys(key for row in rows for key in row))
    table = Table(title=name, title_justify="left", box=None, pad_edge=False)
    for column in columns:
        table.add_column(column.replace("_", " "), justify="left" if _is_text(rows, column) else "right")
    for row in rows:
        table.add_row(*(_shown(row.get(column)) for column in columns))
    console().print(table)
    save(name, rows, path)


def save(name: str, rows: list[Row], path: Path | None) -> None:
    """Write benchmark rows and machine information to a JSON file, if a path is given."""
    if path is None:
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(with_environment(name, rows), indent=2) + "\n", encoding="utf-8")
    finish_with_summary(("figures", path))


def _is_text(rows: Iterable[Row], column: str) -> bool:
    return any(isinstance(row.get(column), str) for row in rows)


def _shown(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.3g}" if isinstance(value, float) else str(value)
