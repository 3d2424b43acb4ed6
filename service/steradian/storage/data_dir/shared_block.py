"""Blocks: small files of one fixed size that processes of one machine overwrite in place and read without a lock.

A block holds one JSON object and its checksum. It has its full size from the start, so a full disk stops no write (on
file systems that copy on write a reserve must be left to it). A reader that meets a write half done sees that by the
checksum and reads again.
"""

from __future__ import annotations

import json
import os
import time
from contextlib import suppress
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any, Final

import google_crc32c

SIZE: Final = 4096
_BLANK: Final = bytes(SIZE)
READ_ATTEMPTS, READ_INTERVAL = 5, 0.001
"""A block that is being written is looked at again, so often and after so many seconds."""


def open_block(path: Path) -> int:
    """Open a block and return its descriptor; one that is missing appears at its full size at once.

    So no write of another process that comes meanwhile is lost.
    """
    if not path.exists():
        with NamedTemporaryFile(dir=path.parent, prefix=f"{path.name}.") as draft:
            draft.write(_BLANK)
            draft.flush()
            os.fsync(draft.fileno())
            with suppress(FileExistsError):
                os.link(draft.name, path)
    return os.open(path, os.O_RDWR | getattr(os, "O_CLOEXEC", 0))


def write_block(descriptor: int, value: dict[str, Any]) -> None:
    """Overwrite a block; two threads of one process must not do so at the same time."""
    body = json.dumps(value, ensure_ascii=False).encode().ljust(SIZE - 9)
    os.pwrite(descriptor, b"%08x " % google_crc32c.value(body) + body, 0)


def read_block(descriptor: int, name: str) -> dict[str, Any] | None:
    """Return the content of a block, ``None`` if it was never written; raises ValueError if it is damaged."""
    for _ in range(READ_ATTEMPTS):
        block = os.pread(descriptor, SIZE, 0)
        if block == _BLANK:
            return None
        if block[:9] == b"%08x " % google_crc32c.value(block[9:]) and len(block) == SIZE:
            value: dict[str, Any] = json.loads(block[9:])
            return value
        time.sleep(READ_INTERVAL)
    raise ValueError(f"{name} does not match its checksum")
