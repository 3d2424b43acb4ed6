"""Table of the benchmark of learned sensor positions, for the documentation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from steradian.benchmarks.report_pages import replace_between_markers

MARKS = (
    "<!-- learned: begin, written by `python -m steradian_benchmarks learned-positions` -->",
    "<!-- learned: end -->",
)
COLUMNS = ("vessel-tree_direct", "yarn_direct", "vessel-tree_iterative", "yarn_iterative")
Row = dict[str, Any]


def best_arrangement(rows: list[Row], column: str) -> float:
    """Return the largest mean correlation of a column among candidates of ``mask compare``."""
    return float(max(row[column] for row in rows if "start" not in row and column in row))


def gap_closed(rows: list[Row], row: Row, column: str) -> float:
    """Return the share of the gap between the best arrangement and a correlation of 1 that a row closes."""
    best = best_arrangement(rows, column)
    return float((row[column] - best) / (1 - best))


def table(rows: list[Row]) -> str:
    """Return the rows as Markdown; of learned masks with the share of the gap closed in brackets."""
    lines = [
        "| points | mask | learned for, on | vessels, direct | yarns, direct | vessels, iterative | yarns, iterative |",
        "|--:|---|---|--:|--:|--:|--:|",
    ]
    for row in rows:
        learned = "start" in row
        mask = f"{row['mask']} from {row['start']}" if learned else row["mask"]
        cells = [f"{row['points']}", mask, f"{row['trained_for']}, {row['trained_on']}" if learned else ""]
        for column in COLUMNS:
            text = f"{row[column]:.3f}" if column in row else ""
            cells.append(f"{text} ({gap_closed(rows, row, column):+.0%})" if learned and text else text)
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def write_page(page: Path, rows: list[Row]) -> None:
    """Replace the table between the markers of a documentation page."""
    replace_between_markers(page, *MARKS, table(rows))
