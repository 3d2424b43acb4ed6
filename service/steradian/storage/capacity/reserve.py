"""Disk reserve: free space that uploads and jobs leave for the database, logs and scans under way."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from steradian.core.exceptions import DiskFull
from steradian.plans.preview import BYTES_PER_ALINE, BYTES_PER_SAMPLE
from steradian.storage.db.tables import PlanRow


@dataclass(frozen=True)
class DiskReserve:
    """Disk reserve of a data directory.

    Attributes
    ----------
    folder
        The data directory.
    reserve
        Bytes that uploads and jobs leave free.
    """

    folder: Path
    reserve: int

    @property
    def free(self) -> int:
        """Free bytes of the disk."""
        return shutil.disk_usage(self.folder).free

    @property
    def available(self) -> int:
        """Free bytes beyond the reserve."""
        return max(0, self.free - self.reserve)

    def require(self, need: int, what: str) -> None:
        """Raise :class:`DiskFull` if less than the reserve would stay free.

        Parameters
        ----------
        need
            Bytes that the work will write.
        what
            Noun of the work, for the error message.

        Raises
        ------
        DiskFull
            With the needed and available bytes.
        """
        if need <= (available := self.available):
            return
        text = (
            f"{what} needs {need / 1e6:.1f} MB; the disk has {self.free / 1e6:.1f} MB free, of which "
            f"{self.reserve / 1e6:.1f} MB stay free"
        )
        raise DiskFull(text, needed=need, available=available)


def scan_bytes(plan: PlanRow) -> int:
    """Return the size in bytes of the scan file that a plan produces."""
    samples: int = plan.preview["bytes"]
    alines: int = samples // (plan.parameters["samples"] * BYTES_PER_SAMPLE)
    return samples + alines * BYTES_PER_ALINE
