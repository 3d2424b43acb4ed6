"""Bytes to and from a port: a terminal (UART, USB, pty) or a TCP socket, both through pyserial."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any, Protocol

import serial

from fabry_perot.errors import LinkLost, PortBusy, PortUnavailable

try:
    import termios

    CLOSING: tuple[type[Exception], ...] = (OSError, termios.error)
except ImportError:  # Windows
    CLOSING = (OSError,)
"""What closing a port that was unplugged raises: it cannot be flushed, and need not be."""

READ_WAIT = 0.02
"""Longest wait for bytes in one read, in s."""
SOCKET_WAIT, SOCKET_CHUNK = 0.004, 4096
"""Longest wait for so many bytes from a socket, in s."""
WRITE_WAIT = 5.0
"""A write that takes longer, in s, means the port is gone."""


class Transport(Protocol):
    """A line that carries bytes."""

    def read(self) -> bytes:
        """Return what has arrived, after a short wait at most; raises LinkLost."""
        ...

    def write(self, data: bytes) -> None:
        """Send all of ``data``; raises LinkLost."""
        ...

    def close(self) -> None:
        """Release the port."""
        ...


class _Port:
    """What both kinds of pyserial port share."""

    def __init__(self, port: Any) -> None:
        self._port = port

    def write(self, data: bytes) -> None:
        """Send all of ``data``; raises LinkLost."""
        try:
            self._port.write(data)
        except (serial.SerialException, OSError, TypeError) as error:
            raise LinkLost(f"cannot write to the port: {error}") from error

    def descriptor(self) -> int | None:
        """Return the file descriptor to wait on for reading, where the port has one."""
        try:
            return int(self._port.fileno())
        except (serial.SerialException, OSError, AttributeError, TypeError, ValueError):
            return None

    def close(self) -> None:
        """Release the port."""
        try:
            self._port.close()
        except CLOSING:
            return


class TerminalTransport(_Port):
    """A tty or pty: takes all that waits in one call, which is what makes reading fast."""

    def read(self) -> bytes:
        """Return what has arrived; raises LinkLost."""
        try:
            return bytes(self._port.read(self._port.in_waiting or 1))
        except (serial.SerialException, OSError, TypeError) as error:
            raise LinkLost(f"the port is gone: {error}") from error


class SocketTransport(_Port):
    """A ``socket://`` port, where pyserial's ``in_waiting`` is only 0 or 1: reads large pieces with a short wait."""

    def read(self) -> bytes:
        """Return what has arrived; raises LinkLost."""
        try:
            return bytes(self._port.read(SOCKET_CHUNK))
        except (serial.SerialException, OSError, TypeError, AttributeError) as error:
            raise LinkLost(f"the connection is gone: {error}") from error

    def close(self) -> None:
        """Release the port; pyserial forgets to close a socket whose peer has gone."""
        plain = getattr(self._port, "_socket", None)
        super().close()
        if plain is not None:
            plain.close()


def open_transport(url: str, baudrate: int = 3_000_000) -> Transport:
    """Open a port for one process alone.

    Parameters
    ----------
    url
        A device path or any URL pyserial knows, for example ``/dev/ttyUSB0`` or ``socket://127.0.0.1:4001``.
    baudrate
        Baud rate of a UART; a pty and USB ignore it.

    Raises
    ------
    PortBusy
        Another process holds it.
    PortUnavailable
        It does not exist or cannot be opened.
    """
    try:
        if "://" in url:
            stuck = None if url.startswith("rfc2217:") else WRITE_WAIT  # which has 5 s of its own, and takes no other
            return SocketTransport(serial.serial_for_url(url, baudrate, timeout=SOCKET_WAIT, write_timeout=stuck))
        port = serial.Serial(url, baudrate, timeout=READ_WAIT, write_timeout=WRITE_WAIT, exclusive=True)
        return TerminalTransport(port)
    except (serial.SerialException, OSError, ValueError) as error:
        text = str(error)
        if getattr(error, "errno", None) in (errno.EAGAIN, errno.EBUSY, errno.EACCES) or "lock" in text:
            raise PortBusy(f"{url} is in use{_by_whom(url)}: {text}") from error
        raise PortUnavailable(f"cannot open {url}: {text}") from error


def _by_whom(path: str) -> str:
    """Name the process that has locked a port, where the system tells."""
    try:
        port = os.stat(path)
        device = f"{os.major(port.st_dev):02x}:{os.minor(port.st_dev):02x}:{port.st_ino}"
        for lock in Path("/proc/locks").read_text().splitlines():
            fields = lock.split()
            if fields[1] == "FLOCK" and fields[5] == device:
                name = Path(f"/proc/{fields[4]}/comm").read_text().strip()
                return f" by {name} (process {fields[4]})"
    except (OSError, IndexError, AttributeError):  # the last on Windows, which has no major()
        pass
    return ""
