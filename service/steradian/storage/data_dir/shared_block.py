"""Small fixed-size files with a checksum, shared between processes and read without a lock.

A file (block) holds one JSON object and its checksum. It has its full size from the start, so that a full disk does not
prevent a write (copy-on-write file systems need a reserve). A reader detects a half-finished write by the checksum and
reads again.
"""

from __future__ import annotations

import json
import os
import time
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any, Final

import google_crc32c

SIZE: Final = 4096
_BLANK: Final = bytes(SIZE)
READ_ATTEMPTS, READ_INTERVAL = 5, 0.001
"""A block that is being written is looked at again, so often and after so many seconds."""


def open_block(path: Path) -> int:
    """Open a shared file, created at full size if missing, and return its descriptor.

    The creation is atomic, so that no concurrent write of another process is lost.
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
    """Overwrite a shared file with a JSON object and its checksum; not thread-safe."""
    body = json.dumps(value, ensure_ascii=False).encode().ljust(SIZE - 9)
    os.pwrite(descriptor, b"%08x " % google_crc32c.value(body) + body, 0)


def read_block(descriptor: int, name: str) -> dict[str, Any] | None:
    """Return the JSON object in a shared file, ``None`` if it is blank; raises ValueError if it is damaged."""
    for _ in range(READ_ATTEMPTS):
        block = os.pread(descriptor, SIZE, 0)
        if block == _BLANK:
            return None
        if (value := _parse(block)) is not None:
            return dict(value)
        time.sleep(READ_INTERVAL)
    raise ValueError(f"{name} does not match its checksum")


@lru_cache(maxsize=16)
def _parse(block: bytes) -> dict[str, Any] | None:
    """Return the JSON object in a block, ``None`` if the checksum differs; cached, because blocks are read often."""
    if block[:9] != b"%08x " % google_crc32c.value(block[9:]) or len(block) != SIZE:
        return None
    value: dict[str, Any] = json.loads(block[9:])
    return value
