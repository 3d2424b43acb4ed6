"""Application of the command line ``steradian-client``: one command group per resource of the HTTP API."""

from __future__ import annotations

from itertools import islice
from typing import Annotated

import typer

from steradian_client.cli import acquisition_commands, processing_commands
from steradian_client.cli.common import client_of
from steradian_client.cli.show import AsJson, print_item
from steradian_client.client import Client

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="""Talk to a Steradian service: masks, plans, scans, reconstructions and jobs.

    Address and key: STERADIAN_URL and STERADIAN_KEY, or url and key in ~/.config/steradian/client.toml.""",
)
for name, commands in {**acquisition_commands.NOUNS, **processing_commands.NOUNS}.items():
    app.add_typer(commands, name=name)


@app.callback()
def _connect(
    context: typer.Context,
    url: Annotated[str | None, typer.Option(help="Address of the service.")] = None,
    patience: Annotated[float, typer.Option(min=0, help="How long a service that is away is tried (s).")] = 60.0,
) -> None:
    context.obj = Client(url, patience=patience)
    context.call_on_close(context.obj.close)


@app.command(help="Show the service's version, mode, limits and readiness.")
def about(context: typer.Context, as_json: AsJson = False) -> None:
    """Print the service's version, mode and limits."""
    client = client_of(context)
    print_item(client.service_info(), as_json)
    if not as_json:
        print_item(client.readiness(), as_json)


@app.command(help="Print events, one JSON object per line, until Ctrl-C.")
def events(
    context: typer.Context,
    kind: Annotated[str | None, typer.Option(help="Only scan, reconstruction, job, batch or scanner.")] = None,
    scan: Annotated[str | None, typer.Option(help="Only events of this scan.")] = None,
    progress: Annotated[bool, typer.Option(help="Also progress.")] = True,
    after: Annotated[str | None, typer.Option(help="Continue after the event with this id.")] = None,
    count: Annotated[int | None, typer.Option(min=1, help="End after so many.")] = None,
) -> None:
    """Print events of the service, one JSON object per line, as they arrive."""
    following = client_of(context).events.follow(kind=kind, scan_id=scan, progress=progress, last_event_id=after)
    for event in islice(following, count):
        print(event.model_dump_json(), flush=True)
