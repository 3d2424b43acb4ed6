"""The API alone: a real process on a data folder, without acquisition and workers."""

import os
import socket
import subprocess
import sys
import tempfile
from contextlib import closing
from functools import cache
from http.client import HTTPConnection, HTTPException

from steradian.core.settings import Settings
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database, metadata_url
from support.forked import Model
from support.waiting import until


@cache
def model():
    """One for all that a process of tests starts."""
    return Model()


class ApiProcess:
    """The process, its database, and what it wrote to standard error once it is closed."""

    def __init__(self, folder, preexec_fn=None, **settings):
        self.settings = Settings.create(data=folder, **settings)
        self.data = DataDirectory(folder)
        self.data.create()
        self.database = Database(metadata_url(self.settings))
        self.database.migrate()
        self._said = tempfile.TemporaryFile()  # a pipe that nobody reads would hold it up
        with socket.create_server(("127.0.0.1", 0)) as listener:
            self.url = f"http://127.0.0.1:{listener.getsockname()[1]}"
            self.process = self._start(listener, preexec_fn)

    def _start(self, listener, preexec_fn):
        if preexec_fn is None:
            return model().copy(listener, self.settings.environment(), self._said)
        process = subprocess.Popen(
            [sys.executable, "-m", "steradian.api", str(listener.fileno())],
            env=self.settings.environment(),
            stdin=subprocess.PIPE,
            stderr=self._said,
            pass_fds=[listener.fileno()],
            preexec_fn=preexec_fn,
            bufsize=0,
        )
        process.stdin.write(b"\n")  # the database is migrated
        return process

    def wait(self):
        """Wait for its first answer."""
        until(self._answers, tell=lambda: "the API did not start")
        return self

    def _answers(self):
        with closing(HTTPConnection(self.url.removeprefix("http://"), timeout=10)) as connection:
            try:
                connection.request("GET", "/healthz")
                return connection.getresponse().status == 200
            except (OSError, HTTPException):
                return False

    @property
    def said(self):
        """What it has written so far."""
        return os.pread(self._said.fileno(), os.fstat(self._said.fileno()).st_size, 0).decode()

    def close(self):
        self.process.stdin.close()
        try:
            self.process.wait(250)
        finally:
            self.process.kill()
            self.log = self.said
            self._said.close()
            self.database.close()
