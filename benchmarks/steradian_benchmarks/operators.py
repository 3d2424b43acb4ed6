"""Benchmark of differentiable operators: products with gradients beside the bare products of the library, in turns.

Requires PyTorch (extra ``torch``).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

import steradian
import steradian.torch
from steradian.benchmarks.report_pages import replace_between_markers
from steradian.core.progress import Progress
from steradian.imaging import AcquisitionGeometry, Compute, ImageGrid

APERTURE, DEPTH, COUNT = 13.56e-3, 3.6e-3, 1605
MODES, SAMPLES, INTERVAL, SPEED = 226, 1024, 16e-9, 1500.0
LIMIT = 1.1
"""Largest time of forward and backward by the image over that of the two bare products."""
BARE = "two bare products"
BY_IMAGE = "forward model, gradient by the image"
MARKS = "<!-- cost: begin, written by `python -m steradian_benchmarks operators` -->", "<!-- cost: end -->"
Row = dict[str, Any]
Case = Callable[[int], object]


def operators(
    *, quick: bool = False, repeats: int = 3, threads: int = 1, progress: Progress | None = None
) -> list[Row]:
    """Measure the processor time of products and gradients of the PyTorch operators in float32.

    Parameters and values are new in each run, as in an optimisation.

    Parameters
    ----------
    quick
        A small scan.
    repeats
        Runs of each case, in turns after one that is not timed; the fastest counts.
    threads
        Threads of all products.
    progress
        Called after each run.

    Returns
    -------
    list of dict
        One row a case: processor seconds, and their ratio to the two bare products.
    """
    cases = _cases(quick=quick, threads=threads)
    seconds = dict.fromkeys(cases, np.inf)
    for run in range(repeats + 1):  # the first one compiles and loads
        for name, work in cases.items():
            start = time.process_time()
            work(run)
            if run:
                seconds[name] = min(seconds[name], time.process_time() - start)
        if progress:
            progress("runs", run + 1, repeats + 1)
    return [{"case": name, "seconds": each, "ratio": each / seconds[BARE]} for name, each in seconds.items()]


def _cases(*, quick: bool, threads: int) -> dict[str, Case]:
    modes, samples, count = (24, 64, 100) if quick else (MODES, SAMPLES, COUNT)
    mask = steradian.equi_steradian_mask(APERTURE, DEPTH, count)
    geometry = AcquisitionGeometry(mask, samples, dt=INTERVAL, sound_speed=SPEED)
    compute = Compute(dtype="float32", threads=threads)
    grid = ImageGrid(modes, depth=(0.0, (samples - 1) * INTERVAL * SPEED))
    bare = steradian.ForwardOperator(geometry, grid, compute=compute)
    model = steradian.torch.ForwardOperator(geometry, grid, compute=compute)
    direct = steradian.torch.DirectReconstruction(geometry, grid, compute=compute)
    random = np.random.default_rng(0)
    image = random.random(bare.volume_shape, np.float32)
    traces = random.random(bare.trace_shape, np.float32)
    image_tensor, traces_tensor = torch.from_numpy(image), torch.from_numpy(traces)

    def positions(run: int) -> torch.Tensor:
        return torch.tensor(mask.positions * (1 - 1e-4 * run), requires_grad=True)

    def timing(run: float) -> dict[str, torch.Tensor]:
        pair = {"sound_speed": SPEED - run, "time_zero": 1e-9 * run}
        return {name: torch.tensor(value, dtype=torch.float64, requires_grad=True) for name, value in pair.items()}

    def bare_products(_: int) -> None:
        bare.forward(image)
        bare.backward(traces)

    def run_model(*, by_image: bool = False, **parameters: Any) -> None:
        given = image_tensor.clone().requires_grad_(by_image)
        model(given, **parameters).backward(traces_tensor)

    def run_direct(*, by_traces: bool = False, **parameters: Any) -> None:
        given = traces_tensor.clone().requires_grad_(by_traces)
        direct(given, **parameters).backward(image_tensor)

    return {
        BARE: bare_products,
        BY_IMAGE: lambda _: run_model(by_image=True),
        "forward model, by positions": lambda run: run_model(positions=positions(run)),
        "forward model, by sound speed and time zero": lambda run: run_model(**timing(run)),
        "forward model, by all": lambda run: run_model(by_image=True, positions=positions(run), **timing(run + 0.5)),
        "direct reconstruction, by the A-lines": lambda _: run_direct(by_traces=True),
        "direct reconstruction, by A-lines and positions": lambda run: run_direct(
            by_traces=True, positions=positions(run)
        ),
    }


def violations(rows: list[Row]) -> list[str]:
    """Return one line for each limit that is exceeded."""
    return [
        f"{row['case']}: {row['ratio']:.2f} of the two bare products, above {LIMIT:g}"
        for row in rows
        if row["case"] == BY_IMAGE and row["ratio"] > LIMIT
    ]


def table(rows: list[Row]) -> str:
    """Return the rows as Markdown."""
    lines = ["| forward and backward | processor seconds | over the two bare products |", "|---|--:|--:|"]
    return "\n".join(lines + [f"| {row['case']} | {row['seconds']:.2f} | {row['ratio']:.2f} |" for row in rows])


def write_page(page: Path, rows: list[Row]) -> None:
    """Replace the table between the markers of a documentation page."""
    replace_between_markers(page, *MARKS, table(rows))
