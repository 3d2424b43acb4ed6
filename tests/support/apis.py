"""The API alone: a real process on a data folder, without acquisition and workers."""

import socket
import subprocess
import sys

import httpx

from steradian.settings import Settings
from steradian.storage.database import Database, metadata_url
from steradian.storage.paths import DataDirectory
from support.waiting import until


class ApiProcess:
    """The process, its database, and what it wrote to standard error once it is closed."""

    def __init__(self, folder, preexec_fn=None, **settings):
        self.settings = Settings.create(data=folder, **settings)
        self.data = DataDirectory(folder)
        self.data.create()
        self.database = Database(metadata_url(self.settings))
        self.database.migrate()
        with socket.create_server(("127.0.0.1", 0)) as listener:
            self.url = f"http://127.0.0.1:{listener.getsockname()[1]}"
            self.process = subprocess.Popen(
                [sys.executable, "-m", "steradian.api", str(listener.fileno())],
                env=self.settings.environment(),
                stdin=subprocess.PIPE,
                stderr=subprocess.PIPE,
                pass_fds=[listener.fileno()],
                preexec_fn=preexec_fn,
            )

    def wait(self):
        """Wait for its first answer."""
        until(self._answers, tell=lambda: "the API did not start")
        return self

    def _answers(self):
        try:
            return httpx.get(f"{self.url}/healthz", timeout=10).is_success
        except httpx.HTTPError:
            return False

    def close(self):
        self.process.stdin.close()
        try:
            self.process.wait(60)
        finally:
            self.process.kill()
            self.log = self.process.stderr.read().decode()
            self.process.stderr.close()
            self.database.close()
