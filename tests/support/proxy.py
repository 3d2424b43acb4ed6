"""A TCP proxy in front of PostgreSQL's socket, or of another server, that a test can cut."""

import contextlib
import socket
import threading

from sqlalchemy import make_url


class Proxy:
    """Passes bytes on while it is open.

    ``cut`` drops every connection and refuses new ones until ``mend``; ``hang`` keeps them and lets nothing through
    until then, as a network does whose cable is out: what was sent meanwhile arrives late.
    """

    def __init__(self, url):
        parts = make_url(url)
        self._listener = socket.create_server(("127.0.0.1", 0))
        port = self._listener.getsockname()[1]
        if parts.drivername.startswith("postgres"):
            self._family = socket.AF_UNIX
            self._target = f"{parts.query['host']}/.s.PGSQL.{parts.port or 5432}"
            self.url = f"postgresql://{parts.username}@127.0.0.1:{port}/{parts.database}"
        else:
            self._family, self._target = socket.AF_INET, (parts.host, parts.port)
            self.url = f"{parts.drivername}://127.0.0.1:{port}"
        self._open, self._pairs = True, []
        self._passes = threading.Event()
        self._passes.set()
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self):
        """End all connections, as a network does that is gone."""
        self._open = False
        for pair in self._pairs:
            for end in pair:
                with contextlib.suppress(OSError):
                    end.shutdown(socket.SHUT_RDWR)

    def hang(self):
        """Let nothing through, in neither direction."""
        self._passes.clear()

    def mend(self):
        """Take connections again, and pass on what was held."""
        self._open = True
        self._passes.set()

    def close(self):
        """End all connections and take no new ones."""
        self.cut()
        self._passes.set()
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
                far = socket.socket(self._family)
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
                self._passes.wait()
                sink.sendall(data)
        self._passes.wait()  # nor does the other side hear that this one is gone
        for end in (source, sink):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
