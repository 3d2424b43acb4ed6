"""The figures of ``steradian benchmark load`` as a page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

BEGIN = "<!-- load: begin, written by `steradian benchmark load` -->"
END = "<!-- load: end -->"
Row = dict[str, Any]


def write_page(page: Path, rows: list[Row]) -> None:
    """Put the tables between the page's marks."""
    text = page.read_text(encoding="utf-8")
    before, after = text.partition(BEGIN)[0], text.partition(END)[2]
    page.write_text(f"{before}{BEGIN}\n{tables(rows)}\n{END}{after}", encoding="utf-8")


def tables(rows: list[Row]) -> str:
    """Write the rows as markdown, a table for each kind."""
    kinds = {kind: [row for row in rows if row["case"] == kind] for kind in ("total", "route", "reads", "rude")}
    parts = _total(kinds["total"][0]), _routes(kinds["route"]), _reads(kinds["reads"]), _rude(kinds["rude"])
    return "\n\n".join(parts)


def _total(row: Row) -> str:
    return (
        f"{row['clients']} clients and {row['streams']} event streams for {row['seconds']:.0f} s:"
        f" {row['requests_per_second']:.0f} requests a second, {row['server_errors']} server errors;"
        f" {row['api_cpu_ms_per_request']:.1f} ms of processor time a request in the API (its streams included) and"
        f" {row['clients_cpu_ms_per_request']:.1f} ms in the clients, on the same processors;"
        f" {row['alines'] - row['alines_lost']:,} of {row['alines']:,} A-lines, the scan {row['scan']};"
        f" {row['jobs_succeeded']} jobs succeeded; the API's memory {row['memory_before_mib']:.0f} MiB before"
        f" and {row['memory_after_mib']:.0f} MiB after."
    )


def _routes(rows: list[Row]) -> str:
    lines = ["| route | requests | p50 (ms) | p99 (ms) | worst (ms) |", "|---|--:|--:|--:|--:|"]
    for row in rows:
        times = [f"{row[name]:,.0f}" if name in row else "" for name in ("p50_ms", "p99_ms", "worst_ms")]
        name = row["route"] if row["light"] else f"{row['route']} (works or reads files)"
        lines.append("| " + " | ".join([name, f"{row['requests']:,}", *times]) + " |")
    return "\n".join(lines)


def _reads(rows: list[Row]) -> str:
    lines = ["| read over 32 connections | reads/s | /healthz beside it | ratio | p99 (ms) |", "|---|--:|--:|--:|--:|"]
    for row in rows:
        rates = [f"{row['reads_per_second']:,.0f}", f"{row['healthz_per_second']:,.0f}", f"{row['ratio']:.2f}"]
        lines.append("| " + " | ".join([row["route"], *rates, f"{row['p99_ms']:.0f}"]) + " |")
    return "\n".join(lines)


def _rude(rows: list[Row]) -> str:
    lines = ["| rude clients | /healthz at worst (ms) | met with | memory (MiB) |", "|---|--:|---|--:|"]
    for row in rows:
        met = ", ".join(f"{count:,} × {_named(what)}" for what, count in row["met_with"].items() if count)
        memory = f"{row['memory_before_mib']:.0f} to {row['memory_after_mib']:.0f}"
        lines.append("| " + " | ".join([row["clients"], f"{row['healthz_worst_ms']:.0f}", met, memory]) + " |")
    return "\n".join(lines)


def _named(what: str) -> str:
    return "cut off" if what == "0" else what
