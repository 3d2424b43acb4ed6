"""``steradian worker``: run workers on this machine for a service on another machine."""

from __future__ import annotations

import re
import socket
from pathlib import Path
from typing import Annotated

import typer

from steradian.cli.console import console, finish_with_summary


def worker(
    workers: Annotated[int | None, typer.Option(help="Reconstructions at a time. [default: 1]")] = None,
    data: Annotated[
        Path | None, typer.Option(help="The service's data folder, as mounted here; with a store its own. [data]")
    ] = None,
    name: Annotated[str | None, typer.Option(help="Unique name of these workers. [default: the host name]")] = None,
    drain: Annotated[
        float | None, typer.Option(help="Seconds to finish a job after a request to end; then it is requeued. [0]")
    ] = None,
) -> None:
    """Execute queued reconstructions of a service on another machine, until Ctrl-C.

    STERADIAN_DATABASE_URL names the PostgreSQL database that both share. The data folder is shared too, over a network
    file system for example, or STERADIAN_STORE names their object store: then this folder is its own. A worker that
    dies is noticed by the others, which take over its job.
    """
    import os
    import signal

    from steradian.core.logging_config import configure_logging
    from steradian.core.settings import PREFIX, Settings
    from steradian.core.signal_safe_event import SignalSafeEvent
    from steradian.runtime import supervisor
    from steradian.storage.data_dir.layout import UMASK

    folder = data if data is not None or f"{PREFIX}DATA" in os.environ else Path("data")
    given = name or os.environ.get(f"{PREFIX}WORKER_NAME") or re.sub(r"[^A-Za-z0-9._-]", "-", socket.gethostname())
    how = {"role": "service", "workers": workers, "worker_name": given, "drain_seconds": drain}
    settings = Settings.create(data=folder, **how)
    os.umask(UMASK)
    configure_logging(settings, "supervisor")
    stop = SignalSafeEvent()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: stop.set())
    supervisor.run_workers(settings, lambda line: console().print(line, soft_wrap=True, markup=False), stop)
    finish_with_summary(("stopped; results and requeued jobs", settings.data))
