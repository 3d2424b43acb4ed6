"""Renderer of the speed benchmark as a documentation table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

BEGIN = "<!-- speed: begin, written by `steradian benchmark speed` -->"
END = "<!-- speed: end -->"
Row = dict[str, Any]


def write_page(page: Path, document: dict[str, Any]) -> None:
    """Replace the table between the markers of a documentation page."""
    text = page.read_text(encoding="utf-8")
    before, after = text.partition(BEGIN)[0], text.partition(END)[2]
    page.write_text(f"{before}{BEGIN}\n{table(document)}\n{END}{after}", encoding="utf-8")


def table(document: dict[str, Any]) -> str:
    """Return the measurements as a Markdown table."""
    machine, rows = document["machine"], document["rows"]
    columns = (
        "case", "sensors", "output", "plan", "run", "one shot", "yardstick", "", "run / it", "limit", "one shot / it",
        "limit", "run / first", "limit", "processor time", "error", "memory", "traffic alone", "arithmetic alone",
        "NED", "FINUFFT",
    )  # fmt: skip
    lines = [
        f"{machine['cpus']} × {machine['processor']}, kernels compiled for {machine['compiled_for']}, Python"
        f" {machine['python']}, {document['measured'][:10]}, load average {_plain(machine['load'], '.1f')}.",
        "",
        "| " + " | ".join(columns) + " |",
        "|" + "---|" * len(columns),
    ]
    lines += ["| " + " | ".join(_cells(row)) + " |" for row in rows]
    return "\n".join(lines)


def _cells(row: Row) -> list[str]:
    return [
        row["case"],
        f"{row['sensors']:,}",
        row["shape"],
        *(_milliseconds(row[name]) for name in ("plan_s", "run_s", "one_shot_s", "yardstick_s")),
        row["yardstick"],
        _plain(row["ratio"], ".2f"),
        _plain(row["limit"], "g"),
        _plain(row["one_shot_ratio"], ".2f"),
        _plain(row["one_shot_limit"], "g"),
        _plain(row["part"], ".2f"),
        _plain(row["part_limit"], "g"),
        f"{row['cpu_ratio']:.2f} / {row['one_shot_cpu_ratio']:.2f}",
        _plain(row["error"], ".1e"),
        _plain(row["extra_memory"], ".2f"),
        *(_milliseconds(row.get(name)) for name in ("traffic_s", "arithmetic_s", "ned_s", "finufft_s")),
    ]


def _plain(value: float | None, how: str) -> str:
    return "" if value is None else format(value, how)


def _milliseconds(seconds: float | None) -> str:
    return "" if seconds is None else f"{1e3 * seconds:,.3g}" if seconds < 0.1 else f"{1e3 * seconds:,.0f}"
