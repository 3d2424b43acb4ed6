"""``steradian check``: verify that a data folder matches its database, or that a backup is intact."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from steradian.cli.console import console

if TYPE_CHECKING:
    from collections.abc import Sequence

    from steradian.runtime.fsck import Inconsistency


def check(
    data: Annotated[Path, typer.Argument(help="The service's data folder, or a backup.", metavar="DATA")],
    repair: Annotated[
        bool, typer.Option("--repair", help="Set damaged databases aside and register scans that are unknown.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
) -> None:
    """Check that data folder and database are consistent, and list the differences.

    The service must not run meanwhile. Without --repair nothing is changed; with it no scan, volume or database is
    deleted. Ends with exit code 3 when something is missing, damaged or unknown. Of a backup each file is compared
    with what was noted when it was made.
    """
    from steradian.core.exceptions import Conflict, NotFound
    from steradian.core.settings import Settings
    from steradian.runtime.backups.manifest import NAME, Manifest
    from steradian.runtime.fsck import Inconsistency, check_consistency
    from steradian.runtime.fsck import repair as mend
    from steradian.storage.data_dir.layout import DataDirectory

    done: list[str] = []
    well = "database and folder agree, nothing is missing"
    if (data / NAME).is_file():
        well = "every file is as it was when the backup was made"
        found = [Inconsistency("damaged-backup", path, fault) for path, fault in Manifest.read(data).verify(data)]
    elif (data / "scans").is_dir():
        settings = Settings.create(data=data)
        if settings.store is not None:
            raise Conflict("with STERADIAN_STORE, `steradian storage check` compares the database with the store")
        with DataDirectory(data).lock():
            done = list(mend(settings)) if repair else []
            found = check_consistency(settings)
    else:
        raise NotFound("data folder", str(data))
    if as_json:
        typer.echo(json.dumps({"findings": [asdict(finding) for finding in found], "repaired": done}, indent=2))
    else:
        for line in done:
            console().print(line, soft_wrap=True, markup=False)
        show_findings(found)
        if not found:
            console().print(f"{data}: {well}", soft_wrap=True, markup=False)
    if found:
        raise typer.Exit(3)


def show_findings(found: Sequence[Inconsistency]) -> None:
    """Print the findings of a consistency check, one per line."""
    for finding in found:
        console().print(f"{finding.kind:17}  {finding.subject}  {finding.text}", soft_wrap=True, markup=False)
