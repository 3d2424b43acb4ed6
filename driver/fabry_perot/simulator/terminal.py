"""Simulated device's line as a pseudo-terminal (POSIX systems only)."""

from __future__ import annotations

import os
import tty
from pathlib import Path

from fabry_perot.device.endpoints import CHUNK


class PtyEndpoint:
    """Endpoint on the master side of a pseudo-terminal, with a link to its slave side.

    Parameters
    ----------
    link
        Path of a symbolic link to make, replacing an older link.
    """

    def __init__(self, link: str | None = None) -> None:
        self._link = Path(link) if link else None
        self._master = self._slave = -1
        self.plug()

    def plug(self) -> None:
        """Create a pseudo-terminal and a symbolic link to it."""
        self._master, self._slave = os.openpty()  # the open slave keeps the line up between two hosts
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.url = os.ttyname(self._slave)
        if self._link is not None:
            fresh = self._link.with_name(f"{self._link.name}.{os.getpid()}")
            if self._link.exists() and not self._link.is_symlink():
                raise FileExistsError(f"{self._link} exists and is not a symbolic link")
            fresh.symlink_to(self.url)
            fresh.replace(self._link)

    def descriptors(self) -> list[int]:
        """Return the pseudo-terminal's master to wait on for reading."""
        return [self._master] if self._master >= 0 else []

    def writable_descriptor(self) -> int | None:
        """Return the pseudo-terminal's master to wait on for writing."""
        return self._master if self._master >= 0 else None

    def read(self, limit: int) -> bytes:
        """Return received bytes without waiting."""
        try:
            return os.read(self._master, min(limit, CHUNK))
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> int:
        """Send as many bytes as fit, and return their number."""
        try:
            return os.write(self._master, data)
        except BlockingIOError:
            return 0

    def unplug(self) -> None:
        """Close the pseudo-terminal and remove the link."""
        if self._master < 0:
            return
        os.close(self._master)
        os.close(self._slave)
        self._master = self._slave = -1
        if self._link is not None and self._link.is_symlink() and os.readlink(self._link) == self.url:
            self._link.unlink()

    def close(self) -> None:
        """Close the pseudo-terminal and remove the link."""
        self.unplug()
