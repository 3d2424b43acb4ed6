"""``steradian storage``: what a service's data folder holds, and deleting of it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from steradian.cli.console import human_size, say, show_figures
from steradian.cli.key import Data, folder_of

if TYPE_CHECKING:
    from steradian.settings import Settings
    from steradian.storage.database import Database

app = typer.Typer(help="Show what a service's data folder holds, and delete of it.", no_args_is_help=True)
KINDS = ("mask", "plan", "scan", "batch", "reconstruction", "job", "upload")


@app.command()
def show(data: Data = None) -> None:
    """Show how many bytes scans, reconstructions, jobs and the rest hold, and how many are free and promised."""
    from steradian.storage.disk import Disk, promised
    from steradian.storage.paths import DataDirectory
    from steradian.storage.usage import usage

    settings, database = _open(data)
    folder, disk = DataDirectory(settings.data), Disk(settings.data, settings.disk_reserve_bytes, settings.quota_bytes)
    try:
        held = {name.replace("_", " "): size for name, size in usage(database, folder).items()}
        with database.read() as session:
            waiting = promised(session, folder)
    finally:
        database.close()
    more = {"free on the disk": disk.free, "stays free": disk.reserve, "promised to scans and jobs": waiting}
    more |= {} if disk.quota is None else {"quota": disk.quota}
    show_figures(f"{settings.data}", {name: human_size(size) for name, size in (held | more).items()})


@app.command()
def delete(
    kind: Annotated[str, typer.Argument(help=f"What it is: {', '.join(KINDS)}.")],
    identifier: Annotated[str, typer.Argument(help="Its identifier.")],
    dependents: Annotated[bool, typer.Option("--dependents", help="Also delete all that depends on it.")] = False,
    data: Data = None,
) -> None:
    """Delete a thing with its files, also while the service runs; what waits or runs keeps what it needs."""
    from steradian.errors import InvalidInput
    from steradian.storage.deletion import Deletion, delete_upload, remove_files
    from steradian.storage.paths import DataDirectory

    if kind not in KINDS:
        raise InvalidInput("kind", kind, ", ".join(KINDS))
    settings, database = _open(data)
    try:
        if kind == "upload":
            delete_upload(database, DataDirectory(settings.data), identifier)
        else:
            who = "command line"
            Deletion(database).delete(kind, identifier, who, dependents=dependents, check=lambda _kinds: None)
        remove_files(database, DataDirectory(settings.data), None)  # the service has its queue forget them
    finally:
        database.close()
    say(f"{kind} {identifier} is deleted from the service in {settings.data}")


def _open(data: Path | None) -> tuple[Settings, Database]:
    """Open the database as the service left it: its tables and the folder are the service's to change."""
    from steradian.errors import Conflict, NotFound
    from steradian.settings import Settings
    from steradian.storage.database import Database, known_revisions, metadata_url
    from steradian.storage.folder import check
    from steradian.storage.paths import DataDirectory

    settings = Settings.create(data=folder_of(data))
    folder = DataDirectory(settings.data)
    if settings.database_url is None and not folder.metadata_file.is_file():
        raise NotFound("data folder", str(folder.root))
    database = Database(metadata_url(settings))
    try:
        revision, newest = database.revision(), known_revisions()[0]
        if revision != newest:
            version = f"the database has version {revision or 'none'}, this command is for {newest}"
            raise Conflict(f"{version}; use the service's Steradian, started once")
        check(database, folder)
    except BaseException:
        database.close()
        raise
    return settings, database
