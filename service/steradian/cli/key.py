"""``steradian key``: create, list and revoke API keys."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from steradian.cli.console import console, print_stderr
from steradian.cli.open_data_folder import Data, folder_of, open_existing_database

if TYPE_CHECKING:
    from steradian.security.keys import KeyStore

app = typer.Typer(help="Make, list and revoke API keys.", no_args_is_help=True)


@app.command()
def create(
    name: Annotated[str, typer.Argument(help="Owner of the key, for the audit log.")],
    scope: Annotated[
        list[str] | None, typer.Option(help="read, plan, operate, reconstruct or admin; may be repeated.")
    ] = None,
    days: Annotated[float | None, typer.Option(help="Validity in days. [default: unlimited]", min=0)] = None,
    data: Data = None,
) -> None:
    """Create a key and print it once: only its hash is stored."""
    from steradian.core.exceptions import InvalidInput
    from steradian.security.keys import Scope

    try:
        scopes = [Scope(text) for text in scope or ["read"]]
    except ValueError:
        raise InvalidInput("scope", ", ".join(scope or []), ", ".join(Scope)) from None
    lifetime = None if days is None else timedelta(days=days)
    folder = folder_of(data)
    with _store(folder) as store:
        typer.echo(store.create(name, scopes, lifetime))
    until = "for ever" if days is None else f"for {days:g} days"
    print_stderr(f"{name} may {', '.join(scopes)}, {until}; only a hash of the key is kept, by the service in {folder}")


@app.command("list")
def list_keys(data: Data = None) -> None:
    """List the keys, without their secrets."""
    folder = folder_of(data)
    with _readable_store(folder) as store:
        rows = store.list()
    for row in rows:
        state = "revoked" if row.revoked else f"until {row.expires:%Y-%m-%d %H:%M}" if row.expires else "valid"
        console().print(f"{row.id}  {row.name}  {' '.join(row.scopes)}  {state}", soft_wrap=True)
    print_stderr(f"{len(rows)} key{'' if len(rows) == 1 else 's'} of the service in {folder}")


@app.command()
def revoke(identifier: Annotated[str, typer.Argument(help="As listed.")], data: Data = None) -> None:
    """Revoke a key: the service rejects it at once."""
    folder = folder_of(data)
    with _store(folder) as store:
        store.revoke(identifier)
    print_stderr(f"{identifier} opens nothing any more in the service in {folder}")


@contextmanager
def _store(folder: Path) -> Iterator[KeyStore]:
    from steradian.core.settings import Settings
    from steradian.security.keys import KeyStore
    from steradian.storage.data_dir.layout import DataDirectory
    from steradian.storage.db.database import Database, metadata_url

    settings = Settings.create(data=folder)
    DataDirectory(settings.data).create()
    database = Database(metadata_url(settings))
    try:
        database.migrate()
        yield KeyStore(database)
    finally:
        database.close()


@contextmanager
def _readable_store(folder: Path) -> Iterator[KeyStore]:
    """Open the key store read-only; a folder without write permission is not modified."""
    from steradian.core.settings import Settings
    from steradian.security.keys import KeyStore
    from steradian.storage.data_dir.layout import DataDirectory
    from steradian.storage.maintenance.permissions import can_write

    settings = Settings.create(data=folder)
    file = DataDirectory(folder).metadata_file
    if settings.database_url is not None or not file.is_file() or can_write(file):
        with _store(folder) as store:
            yield store
        return
    _, database = open_existing_database(folder, reads=True)
    try:
        yield KeyStore(database)
    finally:
        database.close()
