"""``steradian backup`` and ``steradian restore``: back up and restore a service's data."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from steradian.cli.check import show_findings
from steradian.cli.console import finish_with_summary, print_stderr, progress_bar
from steradian.cli.open_data_folder import Data, open_existing_database


def backup(
    destination: Annotated[Path, typer.Argument(help="The folder to make.", metavar="TO")],
    data: Data = None,
) -> None:
    """Back up all data of a service to a new folder, also while it runs.

    What was answered before is in it: scans with every A-line that was stored, volumes, uploads, keys. The folder has
    its name only when it is whole; `steradian check TO` compares it with its manifest. With STERADIAN_DATABASE_URL the
    rows of that database are in it, too.
    """
    from steradian.core.exceptions import Conflict
    from steradian.runtime.backups import create_backup
    from steradian.storage.data_dir.layout import UMASK, DataDirectory

    os.umask(UMASK)
    settings, database = open_existing_database(data)
    try:
        if settings.store is not None:
            text = "is backed up by its own means, as is the database; `steradian storage move folder` brings all back"
            raise Conflict(f"the store {settings.store} {text}")
        with progress_bar() as progress:
            made = create_backup(DataDirectory(settings.data), database, destination, progress=progress)
    finally:
        database.close()
    for scan, fault in made.damaged.items():
        print_stderr(f"scan {scan} {fault}")
    finish_with_summary((f"{made.scans:,} scans and {made.jobs:,} jobs as of {made.made}", destination))


def restore(
    source: Annotated[Path, typer.Argument(help="A folder made by `steradian backup`.", metavar="FROM")],
    destination: Annotated[Path, typer.Argument(help="The data folder to make; it may be empty.", metavar="TO")],
) -> None:
    """Restore a backup as a new data folder, for `steradian serve --data TO`.

    Every file is compared with what was noted when it was made. With STERADIAN_DATABASE_URL the rows go into that
    database, which must be empty; whichever kind the backup was made of. Ends with exit code 3 when something was
    missing already.
    """
    from steradian.core.settings import Settings
    from steradian.runtime.backups import restore as bring_back
    from steradian.storage.data_dir.layout import UMASK

    os.umask(UMASK)
    with progress_bar() as progress:
        found = bring_back(source, Settings.create(data=destination), progress=progress)
    show_findings(found)
    finish_with_summary((f"{source} restored", destination))
    if found:
        raise typer.Exit(3)
