"""``steradian benchmark sound-speed``: error of the speed of sound estimated from simulated scans."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from steradian.cli.benchmark_output import JsonFile, print_and_save
from steradian.cli.console import progress_bar


def sound_speeds(
    json_file: JsonFile = None,
    page: Annotated[Path | None, typer.Option(help="Also write the table into this page, docs/sound-speed.md.")] = None,
) -> None:
    """Estimate the speed of sound in 60 simulated scans of known speed; in m/s."""
    from steradian.benchmarks import sound_speed as measured

    with progress_bar() as progress:
        rows = measured.sound_speeds(progress=progress)
    if page is not None:
        measured.write_page(page, rows)
    print_and_save("sound-speed", rows, json_file)
