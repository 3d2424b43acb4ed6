"""Transports over pyserial: a terminal (UART, USB, pty) or a TCP socket."""

from __future__ import annotations

import errno
import os
import re
import select
import socket
import sys
import time
from pathlib import Path
from typing import Any, Protocol

import serial

from fabry_perot.errors import LinkLost, PortBusy, PortForbidden, PortUnavailable
from fabry_perot.host.address import BAUD, check_url, split
from fabry_perot.host.port_usage import forbidden, holder_of

try:
    import fcntl
    import termios

    CLOSING: tuple[type[Exception], ...] = (OSError, termios.error)
except ImportError:  # Windows
    CLOSING = (OSError,)
"""What closing a port that was unplugged raises: it cannot be flushed, and need not be."""

_TIOCGEXCL = 0x80045440
_SOMEBODY = "another program"
_WHY = {
    errno.ECONNREFUSED: "nothing listens there",
    errno.EHOSTUNREACH: "no way leads to that host",
    errno.ENETUNREACH: "no way leads to that network",
    errno.ETIMEDOUT: "that host does not answer",
    socket.EAI_NONAME: "no such host",
    socket.EAI_AGAIN: "the host name cannot be resolved now",
}
READ_WAIT = 0.02
"""Longest wait for bytes in one read, in s."""
SOCKET_WAIT, SOCKET_CHUNK = 0.004, 4096
"""Longest wait for so many bytes from a socket, in s."""
WRITE_WAIT = 5.0
"""A write that takes longer, in s, means the port is gone."""


class Transport(Protocol):
    """Interface (typing protocol) of a byte transport to a device."""

    def read(self) -> bytes:
        """Return received bytes, after waiting briefly at most; raises LinkLost."""
        ...

    def write(self, data: bytes) -> None:
        """Send all of ``data``; raises LinkLost."""
        ...

    def close(self) -> None:
        """Release the port."""
        ...


class _Port:
    """Base class of the pyserial transports."""

    def __init__(self, port: Any) -> None:
        self._port = port

    def write(self, data: bytes) -> None:
        """Send all of ``data``; raises LinkLost."""
        try:
            self._port.write(data)
        except (serial.SerialException, OSError, TypeError) as error:
            raise LinkLost(f"cannot write to the port: {error}") from error

    def descriptor(self) -> int | None:
        """Return the file descriptor to wait on for reading, if the port has one."""
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
    """Transport on a tty or pty; reads all available bytes in one call, for speed.

    Parameters
    ----------
    port
        The open port.
    baudrate
        Its baud rate in Bd.
    """

    def __init__(self, port: Any, baudrate: int = BAUD) -> None:
        super().__init__(port)
        self.baudrate = baudrate

    def read(self) -> bytes:
        """Return received bytes; raises LinkLost."""
        try:
            return bytes(self._port.read(self._port.in_waiting or 1))
        except (serial.SerialException, OSError, TypeError) as error:
            raise LinkLost(f"the port is gone: {error}") from error


class SocketTransport(_Port):
    """Transport on a ``socket://`` port; reads large chunks, because pyserial's ``in_waiting`` is only 0 or 1."""

    def read(self) -> bytes:
        """Return received bytes; raises LinkLost."""
        ours = type(self._port).__module__.endswith(".protocol_socket")  # the socket of others is read by a thread
        plain = getattr(self._port, "_socket", None) if ours else None
        try:
            return _received(plain) if plain is not None else bytes(self._port.read(SOCKET_CHUNK))
        except (serial.SerialException, OSError, ValueError, TypeError, AttributeError) as error:
            raise LinkLost(f"the connection is gone: {error}") from error

    def close(self) -> None:
        """Close the port and its socket, which pyserial does not close if the peer has closed it."""
        plain = getattr(self._port, "_socket", None)
        super().close()
        if plain is not None:
            plain.close()


def _received(plain: socket.socket) -> bytes:
    """Return bytes received within SOCKET_WAIT s, including those before the end of a connection, which pyserial loses.

    Raises
    ------
    OSError
        The connection has ended, and nothing came before.
    """
    data, deadline = bytearray(), time.monotonic() + SOCKET_WAIT
    while len(data) < SOCKET_CHUNK and (left := deadline - time.monotonic()) > 0 and _is_readable(plain, left):
        try:
            piece = plain.recv(SOCKET_CHUNK - len(data))
        except BlockingIOError:
            continue
        except OSError:
            if data:
                break
            raise
        if not piece:
            if data:
                break  # the next read finds the end again
            raise OSError("socket disconnected")
        data += piece
    return bytes(data)


def _is_readable(plain: socket.socket, seconds: float) -> bool:
    """Wait for bytes or the end of a connection, also for a descriptor beyond the limit of ``select``."""
    if not hasattr(select, "poll"):
        return bool(select.select([plain], [], [], seconds)[0])
    poller = select.poll()
    poller.register(plain, select.POLLIN)
    return bool(poller.poll(seconds * 1e3))


def open_transport(url: str, baudrate: int | None = None) -> Transport:
    """Open a port exclusively for this process.

    Parameters
    ----------
    url
        A device path or any URL pyserial knows, for example ``/dev/ttyUSB0`` or ``socket://127.0.0.1:4001``. Either may
        end with a baud rate, as in ``/dev/ttyUSB0?baud=921600``, which counts more than ``baudrate``.
    baudrate
        Baud rate of a UART, by default 3,000,000 Bd; a pty and USB ignore it.

    Raises
    ------
    PortBusy
        Another process holds it.
    PortForbidden
        This user may not open it.
    PortUnavailable
        It does not exist or cannot be opened.
    PlanInvalid
        The baud rate is out of range.
    """
    port, baud = split(url, baudrate)
    check_url(port)
    try:
        if "://" in port:
            stuck = None if port.startswith("rfc2217:") else WRITE_WAIT  # which has 5 s of its own, and takes no other
            return SocketTransport(serial.serial_for_url(port, baud, timeout=SOCKET_WAIT, write_timeout=stuck))
        opened = serial.Serial(port, baud, timeout=READ_WAIT, write_timeout=WRITE_WAIT, exclusive=True)
    except (serial.SerialException, OSError, ValueError) as error:
        raise _refusal(port, error) from error
    if _is_claimed(opened):
        opened.close()
        raise PortBusy(f"{port} is in use by {holder_of(port) or _SOMEBODY}, which has claimed it (TIOCEXCL)")
    return TerminalTransport(opened, baud)


def _refusal(port: str, error: Exception) -> PortUnavailable | PortBusy:
    """Return the exception for a port that the system fails to open."""
    text, number = str(error), getattr(error, "errno", None)
    if number in (errno.EACCES, errno.EPERM) and sys.platform != "win32":
        return PortForbidden(forbidden(port))
    if number in (errno.EAGAIN, errno.EBUSY, errno.EACCES) or "lock" in text:  # Windows calls a busy port forbidden
        return PortBusy(f"{port} is in use by {holder_of(port) or _SOMEBODY}: {text}")
    if number == errno.ENOENT:
        return PortUnavailable(f"cannot open {port}: no such file; is the scanner plugged in and switched on?")
    if "://" not in port and Path(port).exists() and not _is_terminal(port):
        return PortUnavailable(f"cannot open {port}: it is not a serial port but {_sort_of(port)}")
    reason = text.removeprefix(f"Could not open port {port}: ").removeprefix("Could not configure port: ")
    found = re.match(r"\[Errno (-?\d+)\]", reason)
    why = _WHY.get(int(found[1])) if found else None
    return PortUnavailable(f"cannot open {port}: {why + ' ' if why else ''}{f'({reason})' if why else reason}")


def _is_claimed(port: Any) -> bool:
    """Return whether another program has exclusive access to a terminal, which root could open nevertheless."""
    if sys.platform != "linux":
        return False
    try:
        return bool(int.from_bytes(fcntl.ioctl(port.fileno(), _TIOCGEXCL, bytes(4)), sys.byteorder))
    except OSError:  # a driver that does not tell
        return False


def _is_terminal(path: str) -> bool:
    try:
        file = os.open(path, os.O_RDWR | os.O_NONBLOCK | getattr(os, "O_NOCTTY", 0))
    except OSError:
        return False
    try:
        return os.isatty(file)
    finally:
        os.close(file)


def _sort_of(path: str) -> str:
    file = Path(path)
    return "a folder" if file.is_dir() else "a file" if file.is_file() else "another kind of device"
