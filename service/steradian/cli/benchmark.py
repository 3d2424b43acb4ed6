"""``steradian benchmark``: benchmarks on this machine, each with a baseline from the same run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from steradian.benchmarks.report_pages import with_environment
from steradian.cli.benchmark_output import JsonFile, print_and_save
from steradian.cli.console import console, progress_bar

app = typer.Typer(
    help="Measure this installation; prints a table and, with --json, writes it to a file.", no_args_is_help=True
)


@app.command()
def speed(
    json_file: JsonFile = None,
    repeats: Annotated[int, typer.Option(help="Runs of each case; the fastest counts.", min=1)] = 9,
    quick: Annotated[bool, typer.Option(help="Small versions of all cases: whether they run, no measurement.")] = False,
    page: Annotated[
        Path | None, typer.Option(help="Also write the table between the marks of this page.", exists=True)
    ] = None,
) -> None:
    """Time reconstructions in units of the bare FFTs of their volume (the faster of ducc0 and SciPy, same run).

    'ratio' is ours over the yardstick and 'limit' what it must not exceed, or the command fails; 'one shot' is with the
    plan, 'part' is of the shape's first case. --json and --page have processor time, stages, memory, FINUFFT and what
    traffic and arithmetic alone would cost. "NUMBA_CPU_NAME=haswell NUMBA_CPU_FEATURES=" compiles without AVX-512.
    """
    from steradian.benchmarks.speed import limit_violations
    from steradian.benchmarks.speed import speed as measure
    from steradian.benchmarks.speed_report import write_page

    with progress_bar() as progress:
        rows = measure(quick=quick, repeats=repeats, progress=progress)
    shown = ("case", "shape", "run_s", "one_shot_s", "yardstick_s", "ratio", "limit", "one_shot_ratio", "part", "error")
    print_and_save("speed", rows, json_file, shown)
    if page is not None:
        write_page(page, with_environment("speed", rows))
    if not quick and (exceeded := limit_violations(rows)):
        console().print("\n".join(exceeded))
        raise typer.Exit(1)


@app.command()
def accuracy(json_file: JsonFile = None) -> None:
    """Compare the image's spectrum with direct float64 sums, per tolerance, method and size (relative l2 error).

    Rows of the model compare A-lines with rays and integrals over the spot, and the adjoint with the model in float64.
    """
    from steradian.benchmarks.accuracy import accuracy as measure
    from steradian.benchmarks.medium_accuracy import medium_accuracy

    with progress_bar() as progress:
        rows = [{**row, "adjoint": None} for row in measure(progress=progress)] + medium_accuracy(progress=progress)
    print_and_save("accuracy", rows, json_file)
