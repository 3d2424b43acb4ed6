"""Resumable uploads: files that grow part by part and report their offset (tus 1.0, core protocol)."""

from __future__ import annotations

import fcntl
import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BufferedRandom
from pathlib import Path
from typing import BinaryIO, Self

from steradian.core.exceptions import Conflict, NotFound

PIECE = 2**20


@dataclass(frozen=True)
class Part:
    """Partial upload in a file ``ID.LENGTH.part``, where LENGTH is the final size in bytes.

    Deleted after a day without data.
    """

    path: Path
    length: int

    @classmethod
    def begin(cls, folder: Path, identifier: str, length: int) -> Self:
        """Create the empty partial file of an upload."""
        path = folder / f"{identifier}.{length}.part"
        path.touch(exist_ok=False)
        return cls(path, length)

    @classmethod
    def find(cls, folder: Path, identifier: str) -> Self:
        """Find the partial file of an upload; raises :class:`NotFound`."""
        is_name = identifier.isascii() and identifier.isalnum()
        for path in folder.glob(f"{identifier}.*.part") if is_name else ():
            return cls(path, int(path.name.split(".")[1]))
        raise NotFound("upload", identifier)

    @property
    def offset(self) -> int:
        """Number of received bytes; raises :class:`FileNotFoundError`."""
        return self.path.stat().st_size

    @contextmanager
    def open(self, offset: int) -> Iterator[BinaryIO]:
        """Open the partial file, with an exclusive lock, for appending at ``offset``.

        Raises
        ------
        Conflict
            When the file's size is not ``offset``, or another request writes to the file.
        NotFound
            When the file has been deleted.
        """
        with self._opened() as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise Conflict("another request is sending this upload; query its offset again") from None
            size = file.seek(0, os.SEEK_END)
            if size != offset:
                raise Conflict(f"Upload-Offset is {offset}; allowed: {size}, as many bytes have come")
            yield file

    def digest(self) -> bytes:
        """Flush the file to disk and return its SHA-256 digest."""
        with self._opened() as file:
            os.fsync(file.fileno())
            return hashlib.file_digest(file, "sha256").digest()

    def _opened(self) -> BufferedRandom:
        try:
            return self.path.open("r+b")
        except FileNotFoundError:
            raise NotFound("upload", self.path.name.partition(".")[0]) from None
