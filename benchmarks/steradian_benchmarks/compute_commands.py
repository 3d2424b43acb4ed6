"""Commands of ``python -m steradian_benchmarks`` about CUDA devices, operators and iterative images."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from steradian.benchmarks.report_pages import with_environment
from steradian.cli.benchmark_output import JsonFile, print_and_save
from steradian.cli.console import console, progress_bar


def gpu(
    json_file: JsonFile = None,
    repeats: Annotated[int, typer.Option(help="Runs of each; the median counts.", min=1)] = 20,
    quick: Annotated[bool, typer.Option(help="Tiny versions of all: whether they run, no measurement.")] = False,
    only: Annotated[str, typer.Option(help="Only cases whose name begins with this text.")] = "",
    page: Annotated[Path | None, typer.Option(help="Also write the tables between the marks of this page.")] = None,
    figures: Annotated[Path | None, typer.Option(help="Measure nothing: take an earlier --json, for --page.")] = None,
) -> None:
    """Time a CUDA device (extra gpu): direct images, model, adjoint and a fit, beside cuFFT's pair and the processor.

    'gpu s' is with arrays on the device, 'memory s' from and to NumPy's, 'ratio' over the transform pair of the same
    volume, 'faster' than two processors.
    """
    from steradian_benchmarks import gpu as measured
    from steradian_benchmarks.gpu_report import write_page

    if figures is not None and page is not None:
        write_page(page, json.loads(figures.read_text(encoding="utf-8")))
        return
    with progress_bar() as progress:
        rows = measured.gpu(quick=quick, repeats=repeats, only=only, progress=progress)
    shown = ("device", "case", "shape", "gpu_s", "memory_s", "pair_s", "ratio", "cpu_s", "faster", "error")
    print_and_save("gpu", rows, json_file, shown)
    if page is not None:
        write_page(page, with_environment("gpu", rows))
    if not quick and (missed := measured.limit_violations(rows)):
        console().print("\n".join(missed))
        raise typer.Exit(1)


def operators(
    json_file: JsonFile = None,
    page: Annotated[Path | None, typer.Option(help="Also write the table into this page, docs/operators.md.")] = None,
    quick: Annotated[bool, typer.Option(help="A small scan: whether it runs, no measurement.")] = False,
    repeats: Annotated[int, typer.Option(help="Runs of each; the fastest counts.", min=1)] = 3,
    threads: Annotated[int, typer.Option(help="Threads of all products.", min=1)] = 1,
) -> None:
    """Measure the PyTorch operators (extra torch) with gradients beside the two bare products, in turns.

    'seconds' are of processor time, 'ratio' is over the two bare products; the command fails when that of the gradient
    by the image exceeds 1.1.
    """
    from steradian_benchmarks import operators as measured

    with progress_bar() as progress:
        rows = measured.operators(quick=quick, repeats=repeats, threads=threads, progress=progress)
    print_and_save("operators", rows, json_file)
    if page is not None:
        measured.write_page(page, rows)
    if not quick and (missed := measured.violations(rows)):
        console().print("\n".join(missed))
        raise typer.Exit(1)


def learned_positions(
    json_file: JsonFile = None,
    page: Annotated[Path | None, typer.Option(help="Also write the table into this page, docs/which-mask.md.")] = None,
    quick: Annotated[bool, typer.Option(help="Two steps, one object: whether it runs, no measurement.")] = False,
) -> None:
    """Learn 300 sensor positions by gradient (extra torch), and try them and all candidates of mask compare on others.

    Takes half an hour on one processor.
    """
    from steradian_benchmarks import learned_positions as measured
    from steradian_benchmarks import learned_positions_report as report

    with progress_bar() as progress:
        rows = measured.learned_positions(quick=quick, progress=progress)
    print_and_save("learned-positions", rows, json_file)
    if page is not None:
        report.write_page(page, rows)


def iterative_amplitudes(
    json_file: JsonFile = None,
    page: Annotated[Path | None, typer.Option(help="Also write the table into this page, docs/amplitudes.md.")] = None,
    quick: Annotated[bool, typer.Option(help="One object from few points: whether it runs, no measurement.")] = False,
) -> None:
    """Compare iterative images of held-out vessels and of yarns with the objects: amplitude and correlation.

    The command fails when an amplitude is not 0.95 to 1.05 at 30 dB or 0.9 to 1.05 at 20 dB.
    """
    from steradian_benchmarks import iterative_amplitudes as measured

    with progress_bar() as progress:
        rows = measured.iterative_amplitudes(quick=quick, progress=progress)
    print_and_save("iterative-amplitudes", rows, json_file)
    if page is not None:
        measured.write_page(page, rows)
    if not quick and (missed := measured.violations(rows)):
        console().print("\n".join(missed))
        raise typer.Exit(1)
