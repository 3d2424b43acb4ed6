"""Entry point of the API process.

``python -m steradian.api FD`` serves on the listening socket inherited as file descriptor FD.
"""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading

import uvicorn

from steradian.api.app import create_app
from steradian.api.http.connection_limits import ConnectionLimiter, LimitedConfig, raise_open_file_limit
from steradian.api.middleware.base import ShutdownMiddleware, StreamAdmissionMiddleware
from steradian.core.child_process import exit_when_stdin_closes
from steradian.core.logging_config import configure_logging
from steradian.core.settings import Settings
from steradian.runtime.heartbeat import Heartbeat
from steradian.storage.data_dir.layout import DataDirectory

GRACE = 3
"""Seconds that requests under way get when the service ends."""


def main(descriptor: int) -> None:
    """Run the API server until SIGTERM or SIGINT, or until standard input closes."""
    settings = Settings.create()
    configure_logging(settings, "api")
    config = LimitedConfig(
        ShutdownMiddleware(StreamAdmissionMiddleware(create_app(settings))),
        ConnectionLimiter(raise_open_file_limit(settings.max_connections), settings.client_timeout),
        log_config=None,
        access_log=False,
        timeout_keep_alive=settings.keep_alive,
        timeout_graceful_shutdown=GRACE,
        server_header=False,
    )
    stop = threading.Thread(
        target=exit_when_stdin_closes, args=(lambda: os.kill(os.getpid(), signal.SIGTERM),), daemon=True
    )
    with Heartbeat(DataDirectory(settings.data).heartbeat("api")):
        stop.start()
        uvicorn.Server(config).run(sockets=[socket.socket(fileno=descriptor)])


if __name__ == "__main__":
    if os.read(0, 1):  # the supervisor migrates the database while this process imports its libraries
        main(int(sys.argv[1]))
