"""``steradian serve``: the service."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from steradian.cli.console import console, show_end

DATA = Path("data")


def serve(
    host: Annotated[str | None, typer.Option(help="Address to listen on. [default: 127.0.0.1]")] = None,
    port: Annotated[int | None, typer.Option(help="Port to listen on; 0 takes a free one. [default: 8000]")] = None,
    data: Annotated[Path | None, typer.Option(help="Folder for everything the service keeps. [default: data]")] = None,
    workers: Annotated[int | None, typer.Option(help="Reconstructions at a time. [default: 1]")] = None,
    scanner: Annotated[
        str | None,
        typer.Option(help="Port of the scanner (/dev/ttyUSB0, socket://host:port). [default: simulated]"),
    ] = None,
    simulator_speed: Annotated[
        float | None, typer.Option(help="How much faster than real time a simulated scan runs. [default: 20]")
    ] = None,
) -> None:
    """Serve the HTTP API, run scans and reconstruct, until Ctrl-C ends every process.

    Each option may also be given as a variable, STERADIAN_PORT for example. A second start with the same folder
    finds everything of the first again; queued reconstructions go on. STERADIAN_DATABASE_URL moves metadata and queue
    to a PostgreSQL database, so that `steradian worker` on other machines can help.

    An address that others can reach needs a key: see `steradian key create`.
    """
    import os
    import signal

    from steradian.runtime import supervisor
    from steradian.runtime.logs import configure_logging
    from steradian.settings import PREFIX, Settings
    from steradian.stopping import StopEvent
    from steradian.storage.paths import UMASK

    given = {"host": host, "port": port, "workers": workers, "scanner": scanner, "simulator_speed": simulator_speed}
    folder = data if data is not None or f"{PREFIX}DATA" in os.environ else DATA
    settings = Settings.create(data=folder, **given)
    os.umask(UMASK)
    configure_logging(settings, "supervisor")
    stop = StopEvent()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: stop.set())
    mode = "a simulated scanner" if settings.simulated else f"the scanner at {settings.scanner}"
    supervisor.serve(
        settings, lambda line: console().print(line, soft_wrap=True), stop, on_ready=f"Steradian with {mode}"
    )
    show_end(("stopped; everything is kept", settings.data))
