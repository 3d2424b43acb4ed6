"""A TCP proxy in front of PostgreSQL's socket that a test can cut."""

import contextlib
import socket
import threading

from sqlalchemy import make_url


class Proxy:
    """Passes bytes on while it is open; ``cut`` drops every connection and refuses new ones until ``mend``."""

    def __init__(self, url):
        parts = make_url(url)
        folder = parts.query["host"]
        self._target = f"{folder}/.s.PGSQL.{parts.port or 5432}"
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._open, self._pairs = True, []
        port = self._listener.getsockname()[1]
        self.url = f"postgresql://{parts.username}@127.0.0.1:{port}/{parts.database}"
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self):
        """End all connections, as a network does that is gone."""
        self._open = False
        for pair in self._pairs:
            for end in pair:
                with contextlib.suppress(OSError):
                    end.shutdown(socket.SHUT_RDWR)

    def mend(self):
        """Take connections again."""
        self._open = True

    def close(self):
        """End all connections and take no new ones."""
        self.cut()
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)  # else its thread goes on waiting
        for end in (self._listener, *(end for pair in self._pairs for end in pair)):
            end.close()

    def _accept(self):
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                if not self._open:
                    near.close()
                    continue
                far = socket.socket(socket.AF_UNIX)
                try:
                    far.connect(self._target)
                except OSError:
                    near.close()
                    continue
                self._pairs.append((near, far))
                if not self._open:  # cut just now
                    self.cut()
                for source, sink in ((near, far), (far, near)):
                    threading.Thread(target=self._pass_on, args=(source, sink), daemon=True).start()

    def _pass_on(self, source, sink):
        with contextlib.suppress(OSError):
            while data := source.recv(65_536):
                sink.sendall(data)
        for end in (source, sink):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
