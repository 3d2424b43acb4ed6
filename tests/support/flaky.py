"""A TCP proxy in front of a service that loses what it is told to lose."""

import contextlib
import socket
import struct
import threading
from urllib.parse import urlsplit

RESET = struct.pack("ii", 1, 0)


class Flaky:
    """Passes bytes on, and counts connections and the bytes of answers."""

    def __init__(self, url):
        parts = urlsplit(url)
        self._target = (parts.hostname, parts.port)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        self.connections, self.answered, self.lost = 0, 0, []
        self._pairs, self._lock = [], threading.Lock()
        self._cut_after = self._spoil_after = self._lose = None
        threading.Thread(target=self._accept, daemon=True).start()

    def cut_after(self, count):
        """Reset the connection over which the answers' byte number ``count`` from now on comes, once."""
        self._cut_after = self.answered + count

    def spoil_after(self, count):
        """Change a byte of the answers that come so many bytes from now, once."""
        self._spoil_after = self.answered + count

    def lose_answer(self, start):
        """Reset the next connection on which a request begins with these bytes, when its answer comes."""
        self._lose = start

    def reset(self):
        """Reset all connections now; new ones are taken."""
        with self._lock:
            pairs, self._pairs = self._pairs, []
        for pair in pairs:
            self._end(pair)

    def close(self):
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.reset()

    def _accept(self):
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                self.connections += 1
                try:
                    far = socket.create_connection(self._target)
                except OSError:
                    near.close()
                    continue
                pair = (near, far)
                with self._lock:
                    self._pairs.append(pair)
                marked = threading.Event()
                threading.Thread(target=self._ask, args=(pair, marked), daemon=True).start()
                threading.Thread(target=self._answer, args=(pair, marked), daemon=True).start()

    def _ask(self, pair, marked):
        near, far = pair
        with contextlib.suppress(OSError):
            while data := near.recv(65_536):
                if self._lose is not None and data.startswith(self._lose):
                    marked.set()
                    self.lost.append(self._lose)
                    self._lose = None
                far.sendall(data)
        self._end(pair)

    def _answer(self, pair, marked):
        near, far = pair
        with contextlib.suppress(OSError):
            while data := far.recv(16_384):
                if marked.is_set():
                    break
                self.answered += len(data)
                if self._cut_after is not None and self.answered >= self._cut_after:
                    self._cut_after = None
                    break
                if self._spoil_after is not None and self.answered >= self._spoil_after:
                    self._spoil_after = None
                    data = data[:-1] + bytes([data[-1] ^ 1])
                near.sendall(data)
        self._end(pair)

    @staticmethod
    def _end(pair):
        near, far = pair
        with contextlib.suppress(OSError):
            near.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
        for end in (near, far):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()
