"""Tables of the benchmark of scans in stages, for the documentation."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from steradian.benchmarks.report_pages import replace_between_markers
from steradian.core.progress import Progress
from steradian_benchmarks import stages, stages_enough
from steradian_benchmarks.stages import MASKS, found_share, summary

FOCUS = "<!-- focus: begin, written by `python -m steradian_benchmarks stages` -->", "<!-- focus: end -->"
ENOUGH = "<!-- enough: begin, written by `python -m steradian_benchmarks stages` -->", "<!-- enough: end -->"
Row = dict[str, Any]


def measure(*, quick: bool = False, figures: Path | None = None, progress: Progress | None = None) -> list[Row]:
    """Return the rows of both parts, which their field ``part`` names; those of an earlier JSON file if given."""
    if figures is not None:
        rows: list[Row] = json.loads(figures.read_text(encoding="utf-8"))["rows"]
        return rows
    return stages.stages(quick=quick, progress=progress) + stages_enough.enough(quick=quick, progress=progress)


def part_of(rows: list[Row], part: str) -> list[Row]:
    """Return the rows of one part."""
    return [row for row in rows if row["part"] == part]


def summaries(rows: list[Row]) -> dict[str, list[Row]]:
    """Return the tables to print by the name of their part: means of the first, all rows of the second."""
    return {"focus": summary(part_of(rows, "focus")), "enough": part_of(rows, "enough")}


def violations(rows: list[Row]) -> list[str]:
    """Return one line for each claim that does not hold."""
    return stages.violations(part_of(rows, "focus")) + stages_enough.violations(part_of(rows, "enough"))


def focus_table(rows: list[Row]) -> str:
    """Return mean and worst correlations by number of points, depth and mask as Markdown."""
    lines = ["| points | depth (mm) | mask | direct | worst | iterative | worst |", "|--:|--:|---|--:|--:|--:|--:|"]
    for row in summary(rows):
        cells = [f"{row['points']:,}", f"{row['depth_mm']:g}", row["mask"]]
        for name in ("direct_mean", "direct_worst", "iterative_mean", "iterative_worst"):
            cells.append(f"{row[name]:.3f}" if name in row else "")
        if row["mask"] == MASKS["staged"]:
            cells = [cell if not cell or place < 2 else f"**{cell}**" for place, cell in enumerate(cells)]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join([*lines, "", found_line(rows)])


def found_line(rows: list[Row]) -> str:
    """Return a sentence about the places found."""
    distances = [1e3 * row["distance_m"] for row in rows if row["distance_m"] is not None]
    return (
        f"The survey found {len(distances)} of {len(rows)} objects, {found_share(rows):.0%} of all within 0.5 mm of "
        f"the object's brightest place; distance on average {np.mean(distances):.2f} mm, at most "
        f"{np.max(distances):.2f} mm."
    )


def enough_table(rows: list[Row]) -> str:
    """Return the stops of the yarns by number of points as Markdown; means with the worst in brackets."""
    lines = [
        "| points | stopped at | pulses saved | expected change | actual | loss, direct | loss, iterative |",
        "|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for count in dict.fromkeys(row["points"] for row in rows):
        own = [row for row in rows if row["points"] == count]
        cells = [f"{count:,}", f"{np.mean([row['stopped_at'] for row in own]):,.0f}"]
        cells.append(f"{1 - np.mean([row['share'] for row in own]):.0%}")
        expected = [row["expected_change"] for row in own if row["expected_change"] is not None]
        cells += [f"{np.mean(expected):.3f}", f"{np.mean([row['actual_change'] for row in own]):.3f}"]
        for name in ("direct_loss", "iterative_loss"):
            losses = [row[name] for row in own if name in row]
            cells.append(f"{np.mean(losses):.4f} ({np.max(losses):.4f})" if losses else "")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def write_page(page: Path, rows: list[Row]) -> None:
    """Replace the tables between the markers of a documentation page."""
    parts = ((FOCUS, "focus", focus_table), (ENOUGH, "enough", enough_table))
    for (begin, end), part, table in parts:
        own = part_of(rows, part)
        if own:
            replace_between_markers(page, begin, end, table(own))
