"""Sandbox for a process that opens untrusted files, based on Linux Landlock.

Landlock (Linux 5.13 and later, no privilege needed) leaves a process the files it is told of, no program to start, no
TCP connection (6.7) and no signal to processes outside (6.12); it also ends looking into the memory and environment of
others. Where the kernel has none, what remains are the environment, the limits and the files' permissions.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterable, Mapping
from contextlib import suppress
from enum import IntFlag
from pathlib import Path
from typing import Final

ENV_ALLOWLIST: Final = frozenset(
    {"PATH", "LANG", "LANGUAGE", "TZ", "LD_LIBRARY_PATH", "PYTHONPATH", "PYTHONHOME", "PYTHONWARNINGS", "SYSTEMROOT"}
)
"""Variables that a program needs to be found and to speak, beside those that begin with LC_; none is secret."""
SYSTEM: Final = ("/usr", "/lib", "/lib64", "/etc/ld.so.cache", "/etc/localtime", "/dev/urandom")
"""Where libraries lie that are loaded only when they are used."""
_CREATE, _ADD, _RESTRICT = 444, 445, 446
_NO_NEW_PRIVILEGES = 38


class _Access(IntFlag):
    """Landlock access rights of files, as in ``linux/landlock.h``."""

    WRITE_FILE, READ_FILE, READ_DIR, REMOVE_DIR, REMOVE_FILE = 1 << 1, 1 << 2, 1 << 3, 1 << 4, 1 << 5
    MAKE_DIR, MAKE_REG, TRUNCATE = 1 << 7, 1 << 8, 1 << 14


_READ: Final = _Access.READ_FILE | _Access.READ_DIR
_WRITE: Final = (
    _Access.WRITE_FILE
    | _Access.REMOVE_DIR
    | _Access.REMOVE_FILE
    | _Access.MAKE_DIR
    | _Access.MAKE_REG
    | _Access.TRUNCATE
)
"""No links, sockets, pipes or devices: what is made is a plain file or folder."""
_OF_A_FILE: Final = _Access.READ_FILE | _Access.WRITE_FILE | _Access.TRUNCATE
_BITS_OF_VERSION: Final = {1: 13, 2: 14, 3: 15, 4: 15}
"""Rights to files that each version of Landlock knows; 16 from the fifth on."""


class _Ruleset(ctypes.Structure):
    _fields_ = (("files", ctypes.c_uint64), ("net", ctypes.c_uint64), ("scoped", ctypes.c_uint64))


class _Beneath(ctypes.Structure):
    _pack_ = 1
    _fields_ = (("allowed", ctypes.c_uint64), ("parent", ctypes.c_int32))


def minimal_environment(given: Mapping[str, str], folder: Path) -> dict[str, str]:
    """Return the environment variables for a sandboxed process, with ``folder`` for temporary files."""
    known = {name: value for name, value in given.items() if name in ENV_ALLOWLIST or name.startswith("LC_")}
    return known | {"TMPDIR": str(folder), "HOME": str(folder)}


def set_oom_score(score: int) -> None:
    """Set this process's OOM score: the kernel kills processes with a higher score first (0 to 1000)."""
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(str(score))


def restrict_filesystem(readable: Iterable[Path], folder: Path) -> bool:
    """Restrict this thread, and threads it starts, to ``readable`` files and one writable folder (Landlock).

    Parameters
    ----------
    readable
        Files and folders, beside Python's own and the system's libraries; links count as what they point to.
    folder
        Where files may be made, changed and removed.

    Returns
    -------
    bool
        Whether it is so; ``False`` where the system has no Landlock, and nothing has changed.
    """
    if not sys.platform.startswith("linux"):
        return False
    system = ctypes.CDLL(None, use_errno=True)
    version = system.syscall(_CREATE, None, ctypes.c_size_t(0), ctypes.c_uint32(1))
    if version < 1:
        return False
    handled = (1 << _BITS_OF_VERSION.get(version, 16)) - 1
    rules = _Ruleset(handled, 0b11 if version >= 4 else 0, 0b11 if version >= 6 else 0)
    size = 8 if version < 4 else 16 if version < 6 else 24
    ruleset = system.syscall(_CREATE, ctypes.byref(rules), ctypes.c_size_t(size), ctypes.c_uint32(0))
    if ruleset < 0:
        return False
    try:
        own = [sys.prefix, sys.base_prefix, *sys.path, *SYSTEM]
        for path in {Path(name) for name in own if name} | set(readable):
            _allow(system, ruleset, path, _READ & handled)
        _allow(system, ruleset, Path("/dev/null"), (_Access.READ_FILE | _Access.WRITE_FILE) & handled)
        _allow(system, ruleset, folder, (_READ | _WRITE) & handled)
        system.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0)
        return bool(system.syscall(_RESTRICT, ruleset, ctypes.c_uint32(0)) == 0)
    finally:
        os.close(ruleset)


def _allow(system: ctypes.CDLL, ruleset: int, path: Path, access: int) -> None:
    try:
        place = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except OSError:
        return  # what is not there need not be allowed
    try:
        allowed = access if path.is_dir() else access & _OF_A_FILE
        rule = _Beneath(allowed, place)
        system.syscall(_ADD, ruleset, ctypes.c_int(1), ctypes.byref(rule), ctypes.c_uint32(0))
    finally:
        os.close(place)
