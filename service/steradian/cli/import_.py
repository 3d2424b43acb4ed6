"""``steradian import``: convert a third-party recording to a scan file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import typer

from steradian.cli.console import duration, finish_with_summary, progress_bar, quantity_option, show_figures, speed
from steradian.core.exceptions import InvalidInput

DescriptionOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--description",
        "-d",
        metavar="<path>|<json>",
        help="Values that are not in the source (times, positions, speed): a JSON file, or the object in quotes.",
    ),
]


def parse_description(given: str | None) -> tuple[Path | None, dict[str, Any]]:
    """Return the option's value as the path of a JSON description, or parsed if the value is JSON itself.

    Raises
    ------
    InvalidInput
        When it begins like an object and is none, or names a file of positions, which only lies beside a file.
    """
    if given is None or not given.lstrip().startswith("{"):
        return None if given is None else Path(given), {}
    try:
        fields: dict[str, Any] = json.loads(given)
    except (ValueError, RecursionError) as error:
        raise InvalidInput("description", given, f"a JSON object, or the name of a file: {error}") from error
    if isinstance(fields.get("positions"), str):
        raise InvalidInput("positions", fields["positions"], "a list here; in a file also a file's name")
    if isinstance(fields.get("time_zero"), int | float):
        from steradian.scans.importing.description import TIMES

        times = fields.get("times", "s")
        fields["time_zero"] *= TIMES.get(times, 1.0) if isinstance(times, str) else 1.0
    return None, fields


def import_(
    source: Annotated[
        Path,
        typer.Argument(
            help="IPASC or k-Wave HDF5, MATLAB with sensor_data and dt, .npy, .npz, .csv, .sgl, or a scan file.",
            metavar="SOURCE",
        ),
    ],
    file: Annotated[Path, typer.Argument(help="The scan file to write (HDF5).", metavar="FILE")],
    description: DescriptionOption = None,
    sound_speed: Annotated[float | None, quantity_option(speed, help="Speed of sound; default: the source's.")] = None,
    delay: Annotated[
        float | None,
        quantity_option(duration, help="Time from laser pulse to first sample; overrides the source."),
    ] = None,
    delay_samples: Annotated[
        float | None,
        typer.Option(help="The same in samples, added to --delay; negative: the record begins before the pulse."),
    ] = None,
) -> None:
    """Convert a recording in another format to a scan file.

    What is imported counts as untrusted: links to other files, virtual datasets, object references, pickles,
    absurd sizes and compression bombs are refused, and it is read in a process of its own.
    """
    from steradian.scans.importing.sandbox import import_in_sandbox

    path, options = parse_description(description)
    given = {"sound_speed": sound_speed, "time_zero": delay, "time_zero_samples": delay_samples}
    options |= {name: value for name, value in given.items() if value is not None}
    with progress_bar() as progress:
        summary = import_in_sandbox(source, file, description=path, options=options, progress=progress)
    notes = {f"note {number}": note for number, note in enumerate(summary.notes, 1)}
    show_figures("Import", {"format": summary.format, "samples of an A-line": f"{summary.samples:,}", **notes})
    finish_with_summary((f"{summary.points:,} A-lines", summary.path))
