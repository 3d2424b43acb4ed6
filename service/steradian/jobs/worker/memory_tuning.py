"""Memory tuning of long-running workers: one malloc arena, frozen GC generation."""

from __future__ import annotations

import ctypes
import gc
import sys
from contextlib import suppress
from typing import Final

_ARENA_MAX: Final = -8
"""``M_ARENA_MAX`` of glibc's ``malloc.h``."""


def limit_malloc_arenas() -> None:
    """Limit malloc to one arena for all threads started from now on (glibc only).

    Else glibc gives each thread one of its own, and what one of them freed no other takes: a worker's threads wake in
    turn, and each of their heaps grows to the most that any job needed there. They take turns in Python anyway.
    """
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).mallopt(_ARENA_MAX, 1)


def freeze_garbage_collector() -> None:
    """Move all loaded objects to the permanent generation of the garbage collector (``gc.freeze``).

    Python puts them off until a quarter as much as there is has been added, which here is tens of thousands of objects.
    """
    gc.collect()
    gc.freeze()
