"""Renderer of scaling results as a documentation page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from steradian.benchmarks.load_report import memory_table, routes_table, total_line
from steradian.benchmarks.report_pages import replace_between_markers

BEGIN = "<!-- scale: begin, written by `steradian benchmark scale` -->"
END = "<!-- scale: end -->"
Row = dict[str, Any]


def write_page(page: Path, rows: list[Row]) -> None:
    """Replace the tables between the markers of a documentation page."""
    replace_between_markers(page, BEGIN, END, tables(rows))


def tables(rows: list[Row]) -> str:
    """Return the results as Markdown tables: the jobs, then the clients."""
    parts = [_jobs([row for row in rows if row["case"] == "jobs"])]
    parts += [_arrivals(row) for row in rows if row["case"] == "arrivals"]
    if many := [row for row in rows if row["case"] == "scanners"]:
        parts.append(_scanners(many))
    for where in dict.fromkeys(row["where"] for row in rows if row["case"] == "total"):
        of = {case: [row for row in rows if row["case"] == case and row["where"] == where] for case in _CLIENTS}
        parts += [
            f"### Clients of {where}",
            total_line(of["total"][0]),
            memory_table(of["memory"]),
            routes_table(of["route"]),
        ]
    return "\n\n".join(parts)


_CLIENTS = ("total", "memory", "route")


def _jobs(rows: list[Row]) -> str:
    lines = [
        "| jobs on | jobs/s | s a job | beyond the folder (s) | processor s a job | with store and database |"
        " of what the processors allow |",
        "|---|--:|--:|--:|--:|--:|--:|",
    ]
    for row in rows:
        beyond = "" if row["over_folder_s"] is None else f"{row['over_folder_s']:+.2f}"
        figures = [f"{row['jobs_per_second']:.2f}", f"{row['seconds_per_job']:.2f}", beyond]
        figures += [f"{row[name]:.2f}" for name in ("cpu_s_per_job", "machine_s_per_job", "share")]
        lines.append("| " + " | ".join([row["where"], *figures]) + " |")
    return "\n".join(lines)


def _arrivals(row: Row) -> str:
    between = f"{row['low_s']:.2f} to {row['high_s']:.2f}"
    waits = f"{row['waited_s']:.2f} s in the mean; the model says {row['modelled_s']:.2f} s ({between})"
    return f"{row['jobs']} jobs that came by chance, one worker busy for {row['busy']:.0%} of the time, waited {waits}."


def _scanners(rows: list[Row]) -> str:
    lines = [
        "| scanners | jobs/s | workers | processors for requests | TB a day | event lock held |",
        "|--:|--:|--:|--:|--:|--:|",
    ]
    for row in rows:
        figures = [f"{row['jobs_per_second']:.3f}", f"{row['workers']}", f"{row['api_processors']:.2f}"]
        figures += [f"{1e-3 * row['store_gb_per_day']:.3f}", f"{row['event_lock']:.1%}"]
        lines.append(f"| {row['scanners']:,} | " + " | ".join(figures) + " |")
    return "\n".join(lines)
