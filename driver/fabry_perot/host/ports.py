"""Names of a port that all programs of a computer agree on, and the process that has locked it."""

from __future__ import annotations

import os
import stat
import sys
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlsplit


def aliases(url: str) -> list[str]:
    """Return the names of a port: equal for two spellings of one port, such as a link and its target.

    A terminal is named by its device number, and also by its path, under which it may come back with another number
    after it was unplugged.

    Parameters
    ----------
    url
        A device path or a pyserial URL.
    """
    if "://" in url:
        return [_network_name(url)]
    names = []
    with suppress(OSError):
        status = os.stat(url)
        if stat.S_ISCHR(status.st_mode):
            names.append(f"device {os.major(status.st_rdev)}:{os.minor(status.st_rdev)}")
    path = os.path.abspath(url)
    folder, name = os.path.split(path)
    names.append(f"path {os.path.join(os.path.realpath(folder), name)}")
    target = f"path {os.path.realpath(path)}"
    return names if target in names else [*names, target]


def _network_name(url: str) -> str:
    parts = urlsplit(url)
    host = (parts.hostname or "").lower()
    if host in ("localhost", "::1"):
        host = "127.0.0.1"
    with suppress(ValueError):
        return f"{parts.scheme}://{host}:{parts.port}"
    return url


def lock_owner(url: str) -> int | None:
    """Return the process that has locked a terminal with flock; ``None`` where there is none or the system is silent.

    Parameters
    ----------
    url
        A device path; of a URL nothing is known.
    """
    if "://" in url:
        return None
    with suppress(OSError, IndexError, ValueError, AttributeError):  # the last on Windows, which has no major()
        port = os.stat(url)
        device = f"{os.major(port.st_dev):02x}:{os.minor(port.st_dev):02x}:{port.st_ino}"
        for lock in Path("/proc/locks").read_text().splitlines():
            fields = lock.split()
            if fields[1] == "FLOCK" and fields[5] == device:
                return int(fields[4])
    return None


def program_of(pid: int) -> str:
    """Return the program and number of a process, for example ``"steradian (process 4242)"``."""
    with suppress(OSError):
        return f"{Path(f'/proc/{pid}/comm').read_text().strip()} (process {pid})"
    return f"process {pid}"


def own_name() -> str:
    """Return the name of this program, for example ``"steradian"``."""
    path = Path(sys.argv[0] if sys.argv and sys.argv[0] not in ("", "-c", "-m") else "python")
    return (path.parent.name if path.name == "__main__.py" else path.stem)[:60] or "python"


def may_open(path: str, uid: int, gid: int, pid: int) -> bool:
    """Return whether a process of a user may read and write a path, by owner, groups and mode.

    Parameters
    ----------
    path
        A device path.
    uid, gid, pid
        The asking process, as the system names it.
    """
    try:
        status = os.stat(path)
    except OSError:
        return False
    groups = {gid}
    with suppress(OSError, ValueError):
        for line in Path(f"/proc/{pid}/status").read_text().splitlines():
            if line.startswith("Groups:"):
                groups |= {int(word) for word in line.split()[1:]}
    mode = status.st_mode
    if uid == status.st_uid:
        return mode & 0o600 == 0o600
    if status.st_gid in groups:
        return mode & 0o060 == 0o060
    return mode & 0o006 == 0o006
