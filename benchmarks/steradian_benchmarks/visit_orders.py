"""Benchmark of visit orders on films with non-uniform bias wavelength.

Films, laser and galvo are the simulator's; times are the preview's, and the simulated hardware's by its own clock.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabry_perot.simulator.film import Film
from steradian.benchmarks.report_pages import replace_between_markers
from steradian.core.progress import Progress
from steradian.masks import Mask, equi_steradian_mask
from steradian.plans import Link, ScanPlan, Tuning, VisitOrder, preview
from steradian_benchmarks.simulated_scan_time import simulated_scan_seconds

RETUNING = 5e-3
"""Time of a retuning in s, however far."""
RATES = (1000.0, 50.0)
POINTS, MANY = 1600, 50_000
SEED = 5
FILMS = {
    "scatter": "scatters from point to point",
    "wedge": "smooth wedge",
    "domains": "domains",
    "both": "wedge with domains",
}
ORDERS = ((VisitOrder.SNAKE, 0.0), (VisitOrder.WAVELENGTH, 0.0), (VisitOrder.BANDS, 0.02), (VisitOrder.BANDS, 0.1))
BEGIN, END = "<!-- tuning: begin, written by `python -m steradian_benchmarks tuning` -->", "<!-- tuning: end -->"

Row = dict[str, Any]


def tuning(*, points: int = POINTS, many: int = MANY, progress: Progress | None = None) -> list[Row]:
    """Measure scan times of visit orders on films with non-uniform bias wavelength.

    Parameters
    ----------
    points
        About how many points the mask has.
    many
        About how many points the mask has whose order is timed; 0: none.
    progress
        Told after each film.

    Returns
    -------
    list of dict
        One row a film, pulse rate and order: seconds by the preview (``expected_s``) and by the simulated hardware's
        clock (``simulated_s``), how many times faster than the snake with a retuning a point (``faster``), what
        limits, retunings, wavelengths set, loss of sensitivity, and how long the order took to find (``order_s``).
    """
    mask, rows = equi_steradian_mask(13.56e-3, 3.6e-3, points), list[Row]()
    large = equi_steradian_mask(13.56e-3, 3.6e-3, many) if many else None
    _ = _plan(
        mask, optimal_wavelengths(mask, "scatter"), RATES[0], VisitOrder.BANDS, 0.1
    ).visit  # compiled before the clock runs
    for done, film in enumerate(FILMS):
        best = optimal_wavelengths(mask, film)
        for rate in RATES:
            snake = np.nan
            for order, loss in ORDERS:
                row = _row(_plan(mask, best, rate, order, loss), film)
                snake = row["simulated_s"] if order is VisitOrder.SNAKE else snake
                rows.append(row | {"faster": snake / row["simulated_s"]})
        if large is not None:
            rows.append(
                _row(_plan(large, optimal_wavelengths(large, film), RATES[0], VisitOrder.BANDS, 0.1), film, run=False)
            )
        if progress:
            progress("films", done + 1, len(FILMS))
    return rows


def optimal_wavelengths(mask: Mask, film: str) -> NDArray[np.float64]:
    """Return the optimum bias wavelength of each point of a mask on a simulated film, in m."""
    made = Film(SEED, film)
    places = np.rint(1e9 * mask.film_positions).astype(np.int64).tolist()
    return np.array([made.bias(x, y) for x, y in places]) * 1e-12


def _plan(mask: Mask, best: NDArray[np.float64], rate: float, order: VisitOrder, loss: float) -> ScanPlan:
    return ScanPlan.create(
        mask=mask,
        wavelengths=best,
        max_sensitivity_loss=loss,
        order=order,
        pulse_rate=rate,
        link=Link(byte_rate=None),
        # the snake is tuned to every point's own wavelength
        tuning=Tuning(settling=RETUNING, speed=1.0, tolerance=0.0 if order is VisitOrder.SNAKE else 10e-12),
    )


def _row(plan: ScanPlan, film: str, *, run: bool = True) -> Row:
    start = time.perf_counter()
    _ = plan.visit
    taken = time.perf_counter() - start
    cost = preview(plan)
    row: Row = {
        "film": film,
        "points": plan.mask.count,
        "pulse_rate_hz": plan.pulse_rate,
        "order": str(plan.order),
        "allowed_loss": plan.max_sensitivity_loss,
        "expected_s": cost.total_seconds,
        "limiting": cost.limiting,
        "retunings": cost.retunings,
        "wavelengths": cost.bands,
        "max_loss": cost.sensitivity_loss["max"],
        "mean_loss": cost.sensitivity_loss["mean"],
        "order_s": taken,
    }
    return row | ({"simulated_s": simulated_seconds(plan, film)} if run else {})


def simulated_seconds(plan: ScanPlan, film: str) -> float:
    """Return the duration of a plan on a simulated film, by the simulator's clock."""
    return simulated_scan_seconds(plan, seed=SEED, relief=film, tuning=round(1e6 * RETUNING))


def tables(rows: list[Row]) -> str:
    """Return the measurements as Markdown tables."""
    lines = [
        "| film | pulses (Hz) | order | allowed loss | time (s) | simulated (s) | faster | limited by | retunings |"
        " wavelengths | loss at most | mean loss |",
        "|---|--:|---|--:|--:|--:|--:|---|--:|--:|--:|--:|",
    ]
    for row in rows:
        if "simulated_s" not in row:
            continue
        cells = [FILMS[row["film"]], f"{row['pulse_rate_hz']:g}", row["order"], f"{100 * row['allowed_loss']:g} %"]
        cells += [f"{row['expected_s']:.2f}", f"{row['simulated_s']:.2f}", f"{row['faster']:.2f} ×", row["limiting"]]
        cells += [f"{row['retunings']:,}", f"{row['wavelengths']:,}"]
        cells += [f"{100 * row['max_loss']:.1f} %", f"{100 * row['mean_loss']:.1f} %"]
        lines.append("| " + " | ".join(cells) + " |")
    lines += ["", "| film | points | order found in (s) | time (s) | retunings |", "|---|--:|--:|--:|--:|"]
    for row in rows:
        if "simulated_s" not in row:
            cells = [FILMS[row["film"]], f"{row['points']:,}", f"{row['order_s']:.1f}", f"{row['expected_s']:.1f}"]
            lines.append("| " + " | ".join([*cells, f"{row['retunings']:,}"]) + " |")
    return "\n".join(lines)


def write_page(page: Path, rows: list[Row]) -> None:
    """Replace the table between the markers of a documentation page."""
    replace_between_markers(page, BEGIN, END, tables(rows))
