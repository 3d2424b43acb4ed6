"""Renderer of GPU benchmark results as documentation tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from steradian.benchmarks.report_pages import replace_between_markers

BEGIN = "<!-- gpu: begin, written by `python -m steradian_benchmarks gpu` -->"
END = "<!-- gpu: end -->"
Row = dict[str, Any]
_COLUMNS = {
    "GPU": "gpu_s", "from and to memory": "memory_s", "traces up": "up_s", "image down": "down_s",
    "cuFFT's pair": "pair_s", "processor, two threads": "cpu_s",
}  # fmt: skip
_STEPS = {
    "gpu_s": "lateral step", "grid_fft_s": "its transforms, frequencies innermost", "to_depth_s": "interpolation at κ",
    "grid_fft_outermost_s": "frequencies outermost", "turning_s": "turning one into the other", "to_image_s": "image",
}  # fmt: skip


_DERIVATIVES = {
    "positions_to_traces_s": "positions", "time_to_traces_s": "time zero", "speeds_to_traces_s": "sound speed",
}  # fmt: skip


def write_page(page: Path, document: dict[str, Any]) -> None:
    """Replace the tables between the markers of a documentation page."""
    replace_between_markers(page, BEGIN, END, tables(document))


def tables(document: dict[str, Any]) -> str:
    """Return the measurements as Markdown tables; times in milliseconds."""
    machine, rows = document["machine"], document["rows"]
    ours = [row for row in rows if "cpu_s" in row and "gpu_s" in row]
    lines = [
        f"{rows[0]['device']}; {machine['cpus']} × {machine['processor']}, Python {machine['python']},"
        f" {document['measured'][:10]}. Milliseconds.",
        "",
        "| case | sensors | output | "
        + " | ".join(_COLUMNS)
        + " | GPU / pair | processor / GPU | difference | error |",
        "|---" * (7 + len(_COLUMNS)) + "|",
    ]
    for row in ours:
        cells = [
            row["case"],
            f"{row['sensors']:,}",
            row["shape"],
            *(_time(row.get(name)) for name in _COLUMNS.values()),
        ]
        cells += [_plain(row.get("ratio"), ".2f"), _plain(row.get("faster"), ".1f")]
        cells += [_plain(row.get(name), ".1e") for name in ("difference", "error")]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join([*lines, "", *(line for row in rows for line in _words(row))])


def _words(row: Row) -> list[str]:
    if "fit_s" in row:
        return [
            f"- A fit of the paper's yarn ({row['sensors']:,} sensors, {row['shape']}, {row['fit_products']} products):"
            f" {row['fit_s']:.2f} s, correlation with the truth {row['fit_correlation']:.3f}; the processor on two"
            f" threads {row['cpu_s']:.1f} s and {row['cpu_correlation']:.3f}."
        ]
    if "to_depth_s" in row:
        steps = ", ".join(f"{words} {_time(row[name])}" for name, words in _STEPS.items())
        return [f"- Steps of the first case: {steps}. A copy runs at {row['copied_bytes_per_s'] / 1e12:.2f} TB/s."]
    if "positions_to_traces_s" in row:
        parts = ", ".join(f"by {words} {_time(row[name])}" for name, words in _DERIVATIVES.items())
        return [f"- Derivatives of all A-lines, beside both products in {_time(row['gpu_s'])}: {parts}."]
    if "why_not" in row:
        return [f"- {row['peer']}: not measured ({row['why_not']})."]
    if "setting" in row:
        return [f"- {row['peer']}, the lateral step's sums: {_time(row['gpu_s'])} ({row['setting']})."]
    if "peer" in row:
        products = f"product {_time(row['forward_s'])}, adjoint {_time(row['gpu_s'])}"
        return [f"- {row['peer']}, {row['shape']}, float64: {products}."]
    return []


def _plain(value: float | None, how: str) -> str:
    return "" if value is None else format(value, how)


def _time(seconds: float | None) -> str:
    return "" if seconds is None else f"{1e3 * seconds:,.3g}" if seconds < 0.1 else f"{1e3 * seconds:,.0f}"
