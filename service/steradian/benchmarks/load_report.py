"""Renderer of load-test results as a documentation page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

BEGIN = "<!-- load: begin, written by `steradian benchmark load` -->"
END = "<!-- load: end -->"
Row = dict[str, Any]


def write_page(page: Path, rows: list[Row]) -> None:
    """Replace the tables between the markers of a documentation page."""
    text = page.read_text(encoding="utf-8")
    before, after = text.partition(BEGIN)[0], text.partition(END)[2]
    page.write_text(f"{before}{BEGIN}\n{tables(rows)}\n{END}{after}", encoding="utf-8")


def tables(rows: list[Row]) -> str:
    """Return the load-test results as Markdown, a table for each kind."""
    kinds = {
        kind: [row for row in rows if row["case"] == kind] for kind in ("total", "memory", "route", "reads", "rude")
    }
    parts = (
        total_line(kinds["total"][0]),
        memory_table(kinds["memory"]),
        routes_table(kinds["route"]),
        _reads(kinds["reads"]),
    )
    return "\n\n".join((*parts, _rude(kinds["rude"])))


def total_line(row: Row) -> str:
    """Return a line that summarises the clients' responses."""
    return (
        f"{row['clients']} clients and {row['streams']} event streams for {row['seconds']:.0f} s:"
        f" {row['requests_per_second']:.0f} requests a second, {row['server_errors']} server errors;"
        f" {row['api_cpu_ms_per_request']:.1f} ms of processor time a request in the API (its streams included) and"
        f" {row['clients_cpu_ms_per_request']:.1f} ms in the clients, on the same processors;"
        f" {row['alines'] - row['alines_lost']:,} of {row['alines']:,} A-lines, the scan {row['scan']};"
        f" {row['jobs_succeeded']} jobs succeeded;"
        f" the streams were told {row['events']:,} events, {row['events_lost']} lost, {row['events_again']} told again."
    )


def memory_table(rows: list[Row]) -> str:
    """Return a Markdown table of the memory of each kind of process."""
    lines = ["| process | memory at first (MiB) | at last | at most | growth a minute |", "|---|--:|--:|--:|--:|"]
    for row in rows:
        held = [f"{row[name]:,.0f}" for name in ("first_mib", "last_mib", "most_mib")]
        growth = f"{row['mib_per_minute']:+.1f} ± {row['error']:.1f}" if "error" in row else ""
        lines.append("| " + " | ".join([row["process"], *held, growth]) + " |")
    return "\n".join(lines)


def routes_table(rows: list[Row]) -> str:
    """Return a Markdown table of the response times of each route."""
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
