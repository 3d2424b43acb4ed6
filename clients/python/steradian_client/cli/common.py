"""Options and helpers shared by all command groups."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Any, TypeAlias

import typer

from steradian_client.cli.show import AsJson, Timeout, print_item, print_table, progress_reporter, settings
from steradian_client.client import Client
from steradian_client.resources.base import AwaitableResource, CrudResource, drop_none
from steradian_client.sync_async import SyncMode

ResourceId: TypeAlias = Annotated[str, typer.Argument(metavar="ID")]
Reason: TypeAlias = Annotated[str | None, typer.Option(help="Why.")]
Wait: TypeAlias = Annotated[bool, typer.Option("--wait", help="Wait until it has ended, with progress.")]


def command_group(help: str) -> typer.Typer:
    """Create the command group of a resource."""
    return typer.Typer(no_args_is_help=True, help=help)


def client_of(context: typer.Context) -> Client:
    """Return the HTTP client that all commands share, from the command's context."""
    client: Client = context.obj
    return client


def add_stored(
    app: typer.Typer, those: Callable[[Client], CrudResource[SyncMode, Any]], columns: Sequence[str]
) -> None:
    """Add the commands ``list``, ``show`` and ``delete`` to the command group of a stored resource."""

    @app.command("list", help="List the newest; NAME=VALUE pairs are further filters of the service.")
    def list_(
        context: typer.Context,
        filters: Annotated[list[str] | None, typer.Argument(metavar="[NAME=VALUE]...")] = None,
        state: Annotated[list[str] | None, typer.Option(help="Only those in one of these states.")] = None,
        label: Annotated[list[str] | None, typer.Option(help="Only with this label: NAME or NAME=TEXT.")] = None,
        scan: Annotated[str | None, typer.Option(help="Only of this scan.")] = None,
        mask: Annotated[str | None, typer.Option(help="Only of this mask.")] = None,
        limit: Annotated[int, typer.Option(min=1, help="Most of them.")] = 20,
        as_json: AsJson = False,
    ) -> None:
        named, chosen = settings(filters), drop_none(state=state, label=label, scan_id=scan, mask_id=mask)
        for name in named.keys() & {"limit", *chosen}:
            raise typer.BadParameter(f"{name} is an option: --{name.removesuffix('_id')}")
        print_table(those(client_of(context)).list(limit, **named, **chosen), columns, as_json)

    @app.command("show", help="Show one.")
    def show_(context: typer.Context, identifier: ResourceId, as_json: AsJson = False) -> None:
        print_item(those(client_of(context)).get(identifier), as_json)

    @app.command(help="Delete one permanently.")
    def delete(
        context: typer.Context,
        identifier: ResourceId,
        dependents: Annotated[bool, typer.Option("--dependents", help="Also all that depends on it.")] = False,
    ) -> None:
        those(client_of(context)).delete(identifier, dependents=dependents)


def add_watch(app: typer.Typer, those: Callable[[Client], AwaitableResource[SyncMode, Any]]) -> None:
    """Add the command ``watch``, which shows progress until a resource has ended, to a command group."""

    @app.command(help="Wait until one has ended, with progress; Ctrl-C stops the display, not the work.")
    def watch(context: typer.Context, identifier: ResourceId, timeout: Timeout = None, as_json: AsJson = False) -> None:
        show_when_done(those(client_of(context)), identifier, True, as_json, timeout)


def show_when_done(
    those: AwaitableResource[SyncMode, Any], work: Any, wait: bool, as_json: bool, timeout: float | None = None
) -> None:
    """Print a started resource, immediately or after waiting for its end."""
    if wait:
        with progress_reporter() as progress:
            work = those.wait(work, progress=progress, timeout=timeout)
    print_item(work, as_json)
