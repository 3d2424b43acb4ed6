"""``steradian benchmark look``: time the inspection of A-lines against an FFT of the same A-lines."""

from __future__ import annotations

from typing import Annotated

import typer

from steradian.cli.benchmark_output import JsonFile, print_and_save
from steradian.cli.console import console, progress_bar


def look(
    json_file: JsonFile = None,
    repeats: Annotated[int, typer.Option(help="Runs; the fastest counts.", min=1)] = 5,
    quick: Annotated[bool, typer.Option(help="2,000 A-lines: whether it runs, no measurement.")] = False,
) -> None:
    """Time the inspection of 50,000 A-lines of 1,024 samples beside one real FFT of all of them, in turns.

    'ratio' is the inspection over the FFT; the command fails when 'inspect s' exceeds 'limit s'.
    """
    from steradian.benchmarks.inspecting import inspecting as measure

    with progress_bar() as progress:
        rows = measure(quick=quick, repeats=repeats, progress=progress)
    print_and_save("look", rows, json_file)
    if not quick and rows[0]["inspect_s"] > rows[0]["limit_s"]:
        console().print(f"{rows[0]['inspect_s']:.2f} s exceed {rows[0]['limit_s']:g} s")
        raise typer.Exit(1)
