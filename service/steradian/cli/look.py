"""``steradian look``: a scan's A-lines before any image is made of them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from steradian.cli.console import progress_bar, show_end, show_figures

LISTED = 20
"""Bad A-lines of each kind that are printed; the file of ``--json`` has more."""


def look(
    file: Annotated[Path, typer.Argument(help="A scan file or another known recording.")],
    frame: Annotated[int, typer.Option(help="Which frame of several, from 0.")] = 0,
    to: Annotated[Path | None, typer.Option("--json", help="Write the whole report into this file.")] = None,
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
    if to is not None:
        to.write_text(json.dumps(report) + "\n", encoding="utf-8")
        show_end(("report", to))
