"""``steradian serve``, ``api`` and ``acquisition``: run the whole service or a single node."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from steradian.cli.console import console, finish_with_summary

DATA = Path("data")
Host = Annotated[str | None, typer.Option(help="Address to listen on. [default: 127.0.0.1]")]
Port = Annotated[int | None, typer.Option(help="Port to listen on; 0 takes a free one. [default: 8000]")]
Scanner = Annotated[
    str | None,
    typer.Option(
        help="Port of the scanner (/dev/ttyUSB0, /dev/ttyUSB0?baud=921600, socket://host:port). [default: simulated]"
    ),
]
Speed = Annotated[
    float | None, typer.Option(help="How much faster than real time a simulated scan runs. [default: 20]")
]
Watch = Annotated[
    bool | None,
    typer.Option(
        "--scanner-watch/--no-scanner-watch",
        help="Hold the scanner's port between scans and show laser, shutter, interlock and key. [default: yes]",
    ),
]
RootPath = Annotated[
    str | None,
    typer.Option(help="Path below which a proxy serves this service, like /steradian. [default: none]"),
]
Own = Annotated[Path | None, typer.Option(help="Folder of this node alone. [default: data]")]


def serve(
    host: Host = None,
    port: Port = None,
    data: Annotated[Path | None, typer.Option(help="Data folder of the service. [default: data]")] = None,
    workers: Annotated[int | None, typer.Option(help="Reconstructions at a time. [default: 1]")] = None,
    scanner: Scanner = None,
    simulator_speed: Speed = None,
    scanner_watch: Watch = None,
    root_path: RootPath = None,
) -> None:
    """Serve the HTTP API, run scans and reconstruct, until Ctrl-C ends every process.

    Each option may also be given as a variable, STERADIAN_PORT for example. A second start with the same folder
    finds everything of the first again; queued reconstructions go on. STERADIAN_DATABASE_URL moves metadata and queue
    to a PostgreSQL database, so that `steradian worker` on other machines can help.

    An address that others can reach needs a key: see `steradian key create`.
    """
    where = {"host": host, "port": port, "root_path": root_path, "workers": workers, "scanner": scanner}
    _run(data, role="service", simulator_speed=simulator_speed, scanner_watch=scanner_watch, **where)


def api(host: Host = None, port: Port = None, data: Own = None, root_path: RootPath = None) -> None:
    """Serve the HTTP API as one of several nodes, behind any proxy, until Ctrl-C.

    All nodes share STERADIAN_DATABASE_URL, STERADIAN_STORE and STERADIAN_NODE_SECRET and nothing else. Scanners have
    nodes of their own (`steradian acquisition`); reconstructions are done by `steradian worker`.
    """
    _run(data, role="api", host=host, port=port, root_path=root_path)


def acquisition(
    name: Annotated[str | None, typer.Option(help="Unique name of the scanner. [default: scanner-0]")] = None,
    host: Host = None,
    port: Port = None,
    data: Own = None,
    workers: Annotated[
        int | None, typer.Option(help="Scans followed at a time as images that grow. [default: 1]")
    ] = None,
    scanner: Scanner = None,
    simulator_speed: Speed = None,
    scanner_watch: Watch = None,
) -> None:
    """Run the node of a scanner until Ctrl-C: its scans, its emergency stop and requests of other nodes.

    It shares with the other nodes what `steradian api` does. They reach it at the address that it listens on, or at
    STERADIAN_ADDRESS if that is another one for them. Its folder holds the scans under way; its workers do nothing but
    follow them.
    """
    where = {"scanner_id": name, "host": host, "port": port, "workers": workers, "scanner": scanner}
    _run(data, role="acquisition", simulator_speed=simulator_speed, scanner_watch=scanner_watch, **where)


def _run(data: Path | None, **given: Any) -> None:
    import os
    import signal

    from steradian.core.logging_config import configure_logging
    from steradian.core.settings import PREFIX, Settings
    from steradian.core.signal_safe_event import SignalSafeEvent
    from steradian.runtime import supervisor
    from steradian.storage.data_dir.layout import UMASK

    folder = data if data is not None or f"{PREFIX}DATA" in os.environ else DATA
    settings = Settings.create(data=folder, **given)
    os.umask(UMASK)
    configure_logging(settings, "supervisor")
    stop = SignalSafeEvent()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: stop.set())
    mode = "a simulated scanner" if settings.simulated else f"the scanner at {settings.scanner}"
    title = f"Steradian with {mode}" if settings.has_scanner else "A node of Steradian"
    supervisor.run_service(
        settings, lambda line: console().print(line, soft_wrap=True, markup=False), stop, on_ready=title
    )
    finish_with_summary(("stopped; everything is kept", settings.data))
