"""Supervisor: locks the data directory, and starts and restarts the service's other processes.

supervisor ─┬─ api            answers HTTP on a socket that the supervisor has bound
            ├─ acquisition    runs scans; starts the simulated scanner
            └─ worker-0 …     take jobs; each job is a child of its worker

Where a service is several nodes, an API node has no acquisition and no workers; the API of a scanner's node answers the
other nodes, and its workers only do what grows with a scan.

Each child holds the far end of a pipe as its standard input. When the supervisor is gone, however it went, the pipe
closes and the child ends; its own children likewise.
"""

from __future__ import annotations

import json
import logging
import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import IO

from steradian.core.atomic_files import atomic_write
from steradian.core.child_process import CallProcess
from steradian.core.exceptions import InvalidInput
from steradian.core.logging_config import configure_logging
from steradian.core.settings import PREFIX, Settings
from steradian.runtime import preparation
from steradian.runtime.managed_process import ManagedProcess
from steradian.runtime.singleton_locks import hold_database_lock, hold_scanner_lock
from steradian.runtime.watchdog import CHECK_INTERVAL, Watchdog, responds
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.maintenance.permissions import require_writable

TICK = 0.1
ESSENTIAL, ESSENTIAL_PARTS = frozenset({"api", "acquisition"}), ("emergency-stop", "run")
"""Processes without which there is no service, and the folders whose files each of them writes at its start."""
GRACE = 8.0
"""Seconds that the children get to end before they are killed."""
LISTEN_BACKLOG = 512
_log = logging.getLogger(__name__)


def run_service(
    settings: Settings, announce: Callable[[str], None], stop: threading.Event, *, on_ready: str = "steradian serves"
) -> None:
    """Run the service's processes until ``stop`` is set, then stop them.

    Parameters
    ----------
    announce
        Called with one line for a person once the service answers.

    Raises
    ------
    DataDirectoryInUse
        When another service owns the data directory.
    FolderNotWritable
        When a part of the data directory cannot be written: before anything listens, or once a process ended for it.
    InvalidInput
        When the address cannot be listened on, or the data directory cannot be made, or a node lacks what it must
        share with the others.
    """
    _require_node_settings(settings)
    data = DataDirectory(settings.data)
    require_writable(data)
    with ExitStack() as stack:
        process = stack.enter_context(_preparing(settings))
        process.call(preparation.refuse_unusable, settings)
        stack.enter_context(data.lock())
        for deed in data.restrict_permissions():
            _log.warning("other users of this machine can %s; chmod go-rwx keeps them out", deed)
        owners = stack.enter_context(hold_database_lock(settings)), stack.enter_context(hold_scanner_lock(settings))
        listener = stack.enter_context(_listen(settings))
        url = _url(settings.host, listener.getsockname()[1])
        settings = _with_public_address(settings, listener.getsockname()[1])
        children = _children(settings, listener)
        stack.callback(_forget, data, children)
        stack.callback(_end_all, children, GRACE + settings.drain_seconds)
        children[0].start(time.monotonic(), waits=True)  # the API imports its libraries meanwhile
        if made := process.call(preparation.migrate, settings):
            announce(f"An admin key was created; it is in {made}")
        process.end()
        children[0].go_on()
        announced, watch, checked = False, Watchdog(data, f"{url}/healthz", stop), 0.0
        while not stop.is_set():
            now = time.monotonic()
            if any(child.ended_at_once(now) for child in children if child.name in ESSENTIAL):
                require_writable(data, ESSENTIAL_PARTS)  # else it would be started again for ever
            for child in children:
                child.tend(now)
            if not announced and responds(f"{url}/healthz"):
                announced = True
                with atomic_write(data.root / "run" / "service.json") as beside:
                    beside.write_text(json.dumps({"url": url, "pid": os.getpid()}))
                announce(f"{on_ready} at {url}/api/v1 (data in {settings.data}); Ctrl-C ends it")
            if announced and now - checked >= CHECK_INTERVAL:
                checked = now
                watch.check(children, now)
            for owner in owners:
                owner()
            stop.wait(TICK)


def run_workers(settings: Settings, announce: Callable[[str], None], stop: threading.Event) -> None:
    """Run ``settings.workers`` workers of a service on another host until ``stop`` is set.

    Raises
    ------
    InvalidInput
        When no database is named: only its locks tell hosts of each other's death.
    FolderNotWritable
        When a part of the data folder cannot be written.
    """
    if settings.database_url is None:
        allowed = "postgresql://…, the database of the service; without one, `steradian serve` has its own workers"
        raise InvalidInput("STERADIAN_DATABASE_URL", "missing", allowed)
    require_writable(DataDirectory(settings.data))
    with _preparing(settings) as process:
        process.call(preparation.refuse_foreign_folder, settings)
    if settings.store is not None:  # its own folder, not the service's
        DataDirectory(settings.data).create()
    children = [_worker(settings, slot, None) for slot in range(settings.workers)]
    try:
        announce(f"{settings.workers} workers {settings.worker_slot_name(0)} … on {settings.data}; Ctrl-C ends them")
        while not stop.wait(TICK):
            for child in children:
                child.tend(time.monotonic())
    finally:
        _end_all(children, GRACE + settings.drain_seconds)


@contextmanager
def _preparing(settings: Settings) -> Iterator[CallProcess]:
    """Yield a process for the functions of :mod:`steradian.runtime.preparation`, which Ctrl-C does not reach."""
    child = CallProcess(start_new_session=True)
    try:
        child.call(configure_logging, settings, "supervisor", waits=True)
        yield child
    finally:
        child.end()


@contextmanager
def running_worker(settings: Settings) -> Iterator[None]:
    """Hold the data directory's lock and run one worker without a service until the block ends.

    What the worker says is appended to ``run/worker.log`` in the data directory.

    Raises
    ------
    DataDirectoryInUse
        When a service owns the data directory; submit the job to it instead.
    """
    from steradian.jobs.queue.dbos import migrate_queue  # takes seconds to load

    data = DataDirectory(settings.data)
    require_writable(data)
    with data.lock(), (data.root / "run" / "worker.log").open("ab") as log:
        migrate_queue(settings)  # workers make no tables
        child = _worker(settings, 0, log)
        over = threading.Event()
        keeper = threading.Thread(target=_supervise, args=(child, over), daemon=True)
        keeper.start()
        try:
            yield
        finally:
            over.set()
            keeper.join()
            _end_all([child], GRACE)


def _supervise(child: ManagedProcess, over: threading.Event) -> None:
    while not over.is_set():
        child.tend(time.monotonic())
        over.wait(TICK)


def _children(settings: Settings, listener: socket.socket) -> list[ManagedProcess]:
    descriptor = listener.fileno()
    python, keyless = sys.executable, settings.environment(keys=False)
    api = ManagedProcess(
        "api", [python, "-P", "-m", "steradian.api", str(descriptor)], settings.environment(), (descriptor,)
    )
    acquisition = ManagedProcess("acquisition", [python, "-P", "-m", "steradian.runtime.acquisition"], keyless)
    workers = [_worker(settings, slot, None) for slot in range(settings.workers)]
    return [api] if settings.role == "api" else [api, acquisition, *workers]


def _worker(settings: Settings, slot: int, output: IO[bytes] | None) -> ManagedProcess:
    command = [sys.executable, "-P", "-m", "steradian.runtime.worker_entry", str(slot)]
    return ManagedProcess(settings.worker_slot_name(slot), command, settings.environment(keys=False), output=output)


def _end_all(children: Sequence[ManagedProcess], grace: float) -> None:
    deadline = time.monotonic() + grace
    for child in children:
        child.ask_to_end()
    for child in children:
        child.end(deadline)


def _forget(data: DataDirectory, children: Sequence[ManagedProcess]) -> None:
    """Remove the heartbeat files of the service's own processes, which have ended."""
    for name in ("service", *(child.name for child in children)):
        data.heartbeat(name).unlink(missing_ok=True)


def _require_node_settings(settings: Settings) -> None:
    """Raise an error if the settings of a node lack database, store or secret that all nodes share."""
    if settings.role != "service":
        needed = {
            "database_url": "postgresql://…, the database that all nodes share",
            "store": "s3://…, the object store that all nodes share",
            "node_secret": "32 characters or more, the same for all nodes: they prove themselves with it to each other",
        }
        for name, allowed in needed.items():
            if getattr(settings, name) is None:
                raise InvalidInput(f"{PREFIX}{name.upper()}", "missing", allowed)


def _with_public_address(settings: Settings, port: int) -> Settings:
    """Return the settings with the API's address for other nodes, unless they have one."""
    if settings.address is not None or settings.node_secret is None:
        return settings
    everywhere = settings.host in {"0.0.0.0", "::"}  # noqa: S104 - compared, not bound
    return settings.model_copy(update={"address": _url(socket.gethostname() if everywhere else settings.host, port)})


def _listen(settings: Settings) -> socket.socket:
    try:
        family = socket.getaddrinfo(settings.host, settings.port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((settings.host, settings.port), family=family, backlog=LISTEN_BACKLOG)
    except OSError as error:
        where = f"{settings.host}:{settings.port}"
        raise InvalidInput("host and port", where, f"an address that is free ({error.strerror or error})") from error


def _url(host: str, port: int) -> str:
    """Return the URL of the API for this machine; a wildcard address becomes the loopback address."""
    name = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)  # noqa: S104 - compared, not bound
    return f"http://[{name}]:{port}" if ":" in name else f"http://{name}:{port}"
