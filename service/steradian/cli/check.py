"""``steradian check``: whether a data folder and its database agree."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from steradian.cli.console import console


def check(
    data: Annotated[Path, typer.Argument(help="The service's data folder.", metavar="DATA")],
    repair: Annotated[
        bool, typer.Option("--repair", help="Set damaged databases aside and register scans that are unknown.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
) -> None:
    """Tell what a data folder holds that its database does not know, and the other way round.

    The service must not run meanwhile. Without --repair nothing is changed; with it no scan, volume or database is
    deleted. Ends with exit code 3 when something is missing, damaged or unknown.
    """
    from steradian.errors import NotFound
    from steradian.runtime.inspection import inspect
    from steradian.runtime.inspection import repair as mend
    from steradian.settings import Settings
    from steradian.storage.paths import DataDirectory

    if not (data / "scans").is_dir():
        raise NotFound("data folder", str(data))
    settings = Settings.create(data=data)
    with DataDirectory(data).lock():
        done = list(mend(settings)) if repair else []
        found = inspect(settings)
    if as_json:
        typer.echo(json.dumps({"findings": [asdict(finding) for finding in found], "repaired": done}, indent=2))
    else:
        for line in done:
            console().print(line, soft_wrap=True)
        for finding in found:
            console().print(f"{finding.kind:17}  {finding.subject}  {finding.text}", soft_wrap=True, markup=False)
        if not found:
            console().print(f"{data}: database and folder agree, nothing is missing", soft_wrap=True)
    if found:
        raise typer.Exit(3)
