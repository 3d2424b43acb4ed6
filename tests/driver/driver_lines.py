"""Lines that are almost right: a pseudo-terminal before a scanner's, with a thread between that changes bytes."""

from __future__ import annotations

import os
import select
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Change = Callable[[bytes], bytes]


def same(data: bytes) -> bytes:
    return data


def without_flow_control(data: bytes) -> bytes:
    return data.translate(None, b"\x11\x13")


def with_crlf(data: bytes) -> bytes:
    return data.replace(b"\n", b"\r\n")


def seven_bits(data: bytes) -> bytes:
    return bytes(byte & 0x7F for byte in data)


class Line:
    """A line whose two directions may be changed while it is used.

    Parameters
    ----------
    port
        The scanner's pseudo-terminal.
    up, down
        What happens to bytes on the way to the scanner, and from it.
    """

    def __init__(self, port: str, up: Change = same, down: Change = same) -> None:
        self.up, self.down = up, down
        self._far = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self._near, self._slave = os.openpty()
        for terminal in (self._far, self._slave):
            tty.setraw(terminal)
        os.set_blocking(self._near, False)
        self.url = os.ttyname(self._slave)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._over.is_set():
            ready, _, _ = select.select([self._far, self._near], [], [], 0.02)
            for source, target in ((self._far, self._near), (self._near, self._far)):
                if source in ready:
                    self._pass(source, target)

    def _pass(self, source: int, target: int) -> None:
        try:
            data = os.read(source, 65536)
        except OSError:
            return
        data = self.down(data) if source == self._far else self.up(data)
        while data and not self._over.is_set():
            _, room, _ = select.select([], [target], [], 0.1)
            if room:
                data = data[os.write(target, data) :]

    def close(self) -> None:
        self._over.set()
        self._thread.join(30)
        for descriptor in (self._far, self._near, self._slave):
            os.close(descriptor)


@contextmanager
def line(port: str, up: Change = same, down: Change = same) -> Iterator[Line]:
    made = Line(port, up, down)
    try:
        yield made
    finally:
        made.close()


class Stranger:
    """A port at which something else than a scanner sends bytes.

    Parameters
    ----------
    say
        Returns what is sent next; asked every ``period`` s.
    answer
        Returns what is sent upon bytes that came.
    period
        In s.
    """

    def __init__(self, say: Callable[[], bytes], answer: Change = lambda data: b"", period: float = 0.01) -> None:
        self._say, self._answer, self._period = say, answer, period
        self._near, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._near, False)
        self.url = os.ttyname(self._slave)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._over.is_set():
            ready, _, _ = select.select([self._near], [], [], self._period)
            data = os.read(self._near, 65536) if ready else b""
            out = (self._answer(data) if data else b"") + self._say()
            while out and not self._over.is_set():
                _, room, _ = select.select([], [self._near], [], 0.02)
                if not room:
                    break  # nobody reads: it is lost, as on a real line
                out = out[os.write(self._near, out) :]

    def close(self) -> None:
        self._over.set()
        self._thread.join(30)
        os.close(self._near)
        os.close(self._slave)


@contextmanager
def stranger(
    say: Callable[[], bytes] = lambda: b"", answer: Change = lambda data: b"", period: float = 0.01
) -> Iterator[str]:
    made = Stranger(say, answer, period)
    try:
        yield made.url
    finally:
        made.close()
