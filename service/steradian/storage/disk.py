"""The disk as a resource: what is free of it, and what must stay free so that the service can go on."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from steradian.errors import DiskFull


@dataclass(frozen=True)
class Disk:
    """The disk under a data directory.

    Attributes
    ----------
    folder
        Any folder on it.
    reserve
        Bytes that uploads and jobs leave free, for the database, for logs and for scans under way.
    """

    folder: Path
    reserve: int

    @property
    def free(self) -> int:
        """Bytes that are free now."""
        return shutil.disk_usage(self.folder).free

    @property
    def available(self) -> int:
        """Bytes of them that uploads and jobs may take."""
        return max(0, self.free - self.reserve)

    def require(self, need: int, what: str) -> None:
        """Refuse what does not fit.

        Parameters
        ----------
        need
            Bytes.
        what
            Who needs them, in the words of the refusal.

        Raises
        ------
        DiskFull
            With what is needed and what is there.
        """
        if need > (available := self.available):
            text = (
                f"{what} needs {need / 1e6:.1f} MB; the disk has {available / 1e6:.1f} MB beyond the "
                f"{self.reserve / 1e6:.1f} MB that stay free"
            )
            raise DiskFull(text, needed=need, available=available)
