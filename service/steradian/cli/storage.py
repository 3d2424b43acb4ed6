"""``steradian storage``: list and delete stored resources, and move them to an object store and back."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from steradian.cli.console import console, human_size, print_stderr, progress_bar, show_figures
from steradian.cli.open_data_folder import Data, open_existing_database

if TYPE_CHECKING:
    from steradian.core.settings import Settings
    from steradian.storage.blobs.object_store import S3BlobStore
    from steradian.storage.db.database import Database

app = typer.Typer(help="Show, delete and move a service's stored data.", no_args_is_help=True)
KINDS = ("mask", "plan", "scan", "batch", "reconstruction", "job", "upload")


@app.command()
def show(data: Data = None) -> None:
    """Show the bytes used by scans, reconstructions, jobs and the rest, and the free space."""
    from steradian.storage.capacity.reserve import DiskReserve
    from steradian.storage.capacity.usage import usage
    from steradian.storage.data_dir.layout import DataDirectory

    settings, database = open_existing_database(data, reads=True)
    folder, disk = DataDirectory(settings.data), DiskReserve(settings.data, settings.disk_reserve_bytes)
    try:
        held = {name.replace("_", " "): size for name, size in usage(database, folder).items()}
    finally:
        database.close()
    more = {"free on the disk": disk.free, "stays free": disk.reserve}
    show_figures(f"{settings.data}", {name: human_size(size) for name, size in (held | more).items()})


@app.command()
def delete(
    kind: Annotated[str, typer.Argument(help=f"What it is: {', '.join(KINDS)}.")],
    identifier: Annotated[str, typer.Argument(help="Its identifier.")],
    dependents: Annotated[bool, typer.Option("--dependents", help="Also delete all that depends on it.")] = False,
    data: Data = None,
) -> None:
    """Delete a resource with its files, also while the service runs; queued and running jobs keep their inputs."""
    from steradian.core.exceptions import InvalidInput
    from steradian.storage.blobs.object_store import arrays_of
    from steradian.storage.data_dir.layout import DataDirectory
    from steradian.storage.repositories.deletion import DeletionService, delete_upload, remove_files

    if kind not in KINDS:
        raise InvalidInput("kind", kind, ", ".join(KINDS))
    settings, database = open_existing_database(data)
    folder, arrays = DataDirectory(settings.data), arrays_of(settings, database)
    try:
        if kind == "upload":
            delete_upload(database, arrays, identifier)
        else:
            who = "command line"
            DeletionService(database).delete(kind, identifier, who, dependents=dependents, check=lambda _kinds: None)
        remove_files(database, folder, arrays, None)  # the service has its queue forget them
    finally:
        database.close()
    print_stderr(f"{kind} {identifier} is deleted from the service in {settings.data}")


@app.command()
def check(
    contents: Annotated[bool, typer.Option("--contents", help="Also read every object, and compare it.")] = False,
    sweep: Annotated[bool, typer.Option("--sweep", help="Delete old objects that nothing needs.")] = False,
    data: Data = None,
) -> None:
    """Compare the database with the object store (STERADIAN_STORE), also while the service runs.

    Ends with exit code 3 when an object is missing or damaged.
    """
    settings, database = open_existing_database(data)
    try:
        store = _store(settings, database)
        found = store.audit()
        bad = dict.fromkeys(found.missing, "is missing or has another size")
        if contents:
            whole = [row.name for row in store.rows() if row.name not in bad]
            bad |= {name: "does not match its checksum" for name in whole if not store.is_whole(name)}
        figures = {"objects": f"{found.objects:,}", "bytes": human_size(found.bytes)}
        figures["needed by nothing, older than a day"] = f"{len(found.orphans):,}"
        if sweep:
            figures["of them deleted"] = f"{store.collect_orphans():,}"
    finally:
        database.close()
    for name, fault in bad.items():
        console().print(f"{name} {fault}", soft_wrap=True, markup=False)
    show_figures(store.place, figures)
    if bad:
        raise typer.Exit(3)


@app.command()
def move(
    to: Annotated[str, typer.Argument(help="store or folder.", metavar="TO")],
    data: Data = None,
) -> None:
    """Move finished scans and jobs from the data folder to the object store (STERADIAN_STORE) or back.

    Stop the service first.

    Everything is read back before it is removed where it was. A move that was stopped goes on where it was. Afterwards
    start the service with STERADIAN_STORE, or without.
    """
    from steradian.core.exceptions import InvalidInput
    from steradian.runtime.archive.transfer import move_to_folder, move_to_store
    from steradian.runtime.singleton_locks import hold_database_lock
    from steradian.storage.data_dir.layout import DataDirectory

    if to not in {"store", "folder"}:
        raise InvalidInput("to", to, "store or folder")
    settings, database = open_existing_database(data)
    folder = DataDirectory(settings.data)
    try:
        store = _store(settings, database)
        with folder.lock(), hold_database_lock(settings), progress_bar() as progress:
            if to == "store":
                store.bind()
                count = move_to_store(store, database, folder, progress)
            else:
                store.check()
                count = move_to_folder(store, folder, progress)
    finally:
        database.close()
    print_stderr(f"{count:,} files are moved to {store.place if to == 'store' else settings.data}")


def _store(settings: Settings, database: Database) -> S3BlobStore:
    from steradian.core.exceptions import InvalidInput
    from steradian.storage.blobs.object_store import S3BlobStore

    if settings.store is None:
        raise InvalidInput("STERADIAN_STORE", "missing", "s3://bucket/prefix; `steradian check` compares a folder")
    return S3BlobStore(settings, database)
