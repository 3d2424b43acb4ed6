"""``steradian worker``: workers of a service that runs elsewhere."""

from __future__ import annotations

import re
import socket
from pathlib import Path
from typing import Annotated

import typer

from steradian.cli.console import console, show_end


def worker(
    workers: Annotated[int | None, typer.Option(help="Reconstructions at a time. [default: 1]")] = None,
    data: Annotated[
        Path | None, typer.Option(help="The service's data folder, as it is mounted here. [default: data]")
    ] = None,
    name: Annotated[
        str | None, typer.Option(help="Name of these workers, unlike any other's. [default: this host's]")
    ] = None,
) -> None:
    """Take reconstructions from the queue of a service on another machine, until Ctrl-C.

    STERADIAN_DATABASE_URL names the PostgreSQL database that both share; the data folder is shared too, over a network
    file system for example. A worker that dies is noticed by the others, which take over its job.
    """
    import os
    import signal

    from steradian.runtime import supervisor
    from steradian.runtime.logs import configure_logging
    from steradian.settings import PREFIX, Settings
    from steradian.stopping import StopEvent
    from steradian.storage.paths import UMASK

    folder = data if data is not None or f"{PREFIX}DATA" in os.environ else Path("data")
    given = name or os.environ.get(f"{PREFIX}WORKER_NAME") or re.sub(r"[^A-Za-z0-9._-]", "-", socket.gethostname())
    settings = Settings.create(data=folder, workers=workers, worker_name=given)
    os.umask(UMASK)
    configure_logging(settings, "supervisor")
    stop = StopEvent()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: stop.set())
    supervisor.work(settings, lambda line: console().print(line, soft_wrap=True), stop)
    show_end(("stopped; results, and what goes back to the queue,", settings.data))
