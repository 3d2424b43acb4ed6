"""Formatters for Markdown tables, pictures and numbers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence


def table(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a Markdown table; the first column is text, the others are aligned to the right."""
    lines = [_row(columns), "|" + "|".join(["---"] + ["--:"] * (len(columns) - 1)) + "|"]
    return "\n".join(lines + [_row([*map(str, row)]) for row in rows]) + "\n"


def picture(name: str, words: str) -> str:
    """Return the Markdown of a picture named by :meth:`SectionContext.picture`, with its alternative text."""
    return f"![{words}](paper/{name}.png)\n"


def number(value: float | None, digits: int = 3) -> str:
    """Format a number with a fixed number of decimals; None as a dash."""
    if value is None or not math.isfinite(value):
        return "–"
    return f"{value:,.{digits}f}".replace("-", "−")


def with_error(value: float | None, error: float | None, digits: int = 1) -> str:
    """Format a value and its spread, for example 33.4 ± 8.0."""
    return f"{number(value, digits)} ± {number(error, digits)}"


def percent(share: float | None, digits: int = 0) -> str:
    """Format a fraction as a percentage."""
    return number(None if share is None else 100 * share, digits) + " %"


def spread(values: Sequence[float], digits: int = 3) -> str:
    """Format the range of several runs, for example 0.951–0.962."""
    low, high = number(min(values), digits), number(max(values), digits)
    return low if low == high else f"{low}–{high}"


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"
