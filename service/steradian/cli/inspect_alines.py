"""``steradian look``: inspect the A-lines of a scan before reconstruction."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from steradian.cli.console import finish_with_summary, progress_bar, show_figures

if TYPE_CHECKING:
    from steradian.scans.inspection import Inspection

LISTED = 20
"""Bad A-lines of each kind that are printed; the file of ``--json`` has more."""


def look(
    file: Annotated[Path, typer.Argument(help="A scan file or another known recording.")],
    frame: Annotated[int, typer.Option(help="Which frame of several, from 0.")] = 0,
    to: Annotated[Path | None, typer.Option("--json", help="Write the whole report into this file.")] = None,
    picture: Annotated[Path | None, typer.Option(help="Draw histogram, spectrum and maps into this PNG.")] = None,
    all_frames: Annotated[bool, typer.Option("--all-frames", help="Compare all frames: power, baseline, bad.")] = False,
) -> None:
    """Inspect A-lines before imaging: codes, noise, baseline, and bad A-lines by kind. Changes nothing."""
    from steradian.scans.inspection import inspect_scan

    with progress_bar() as progress:
        found = inspect_scan(file, frame, progress=progress)
    report = found.to_dict()
    histogram, power = report["histogram"], report["frames"][0]
    low, high = histogram["clipped_low"], histogram["clipped_high"]
    figures: dict[str, object] = {
        "A-lines": f"{report['looked_at']} of {report['alines']}, {report['samples']} samples each",
        "clipped samples": f"{low} at the least value, {high} at the greatest",
    }
    if histogram["kind"] == "codes":
        figures["missing codes"] = histogram["missing_codes"]
        figures["mid-scale offset"] = f"{histogram['mid_scale_offset']:.3g} codes"
    figures["power"] = f"{power['power']:.3g} +- {power['power_spread']:.2g}"
    figures["baseline"] = f"{power['baseline']:.3g} +- {power['baseline_spread']:.2g}"
    figures["bad A-lines"] = ", ".join(f"{count} {kind}" for kind, count in found.kinds.items()) or "none found"
    if not report["decidable"]:
        figures["not decidable"] = "inverted and shifted A-lines: neighbours are not alike"
    show_figures("Signals", figures)
    for kind in found.kinds:
        those = [line for line in report["bad"] if line["kind"] == kind]
        for line in those[:LISTED]:
            place = f"({1e3 * line['x']:.3f}, {1e3 * line['y']:.3f}) mm"
            typer.echo(f"{kind:<9} A-line {line['aline']:>6} at {place}: {line['detail']}")
        if found.kinds[kind] > LISTED:
            typer.echo(f"{kind:<9} and {found.kinds[kind] - LISTED} more")
    if all_frames:
        report["frames"] = _compare(file, found)
    if picture is not None:
        from steradian.scans.inspection_figure import draw_inspection

        draw_inspection(found, picture)
        finish_with_summary(("picture", picture))
    if to is not None:
        to.write_text(json.dumps(report) + "\n", encoding="utf-8")
        finish_with_summary(("report", to))


def _compare(file: Path, one: Inspection) -> list[dict[str, object]]:
    """Print one line of statistics for each frame, and return the statistics of all frames."""
    from steradian.scans.file.read import list_frames
    from steradian.scans.frames import Frame
    from steradian.scans.importing.detect import is_scan_file
    from steradian.scans.inspection import inspect_scan

    rows: list[dict[str, object]] = []
    for frame in list_frames(file) if is_scan_file(file) else [Frame(0, 0.0, len(one.rows))]:
        if not frame.stored:
            continue
        with progress_bar() as progress:
            found = one if frame.index == one.frame else inspect_scan(file, frame.index, progress=progress)
        row = found.statistics() | {"bad": sum(found.kinds.values())}
        light = f" at {1e9 * frame.excitation:.4g} nm" if frame.excitation else ""
        power = f"power {row['power']:.3g} +- {row['power_spread']:.2g}"
        baseline = f"baseline {row['baseline']:.3g} +- {row['baseline_spread']:.2g}"
        typer.echo(f"frame {frame.index}{light}: {row['alines']} A-lines, {power}, {baseline}, {row['bad']} bad")
        rows.append(row)
    return rows
