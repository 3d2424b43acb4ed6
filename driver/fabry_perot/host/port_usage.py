"""Canonical names of a port, the processes that use it, and its permissions."""

from __future__ import annotations

import os
import stat
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from fabry_perot.host.address import port_of


def aliases(url: str) -> list[str]:
    """Return all names of a port; two spellings of one port, such as a link and its target, have equal names.

    A terminal is named by its device number, and also by its path, under which it may come back with another number
    after it was unplugged.

    Parameters
    ----------
    url
        A device path or a pyserial URL.
    """
    url = port_of(url)
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
    """Return the process with a flock lock on a terminal; ``None`` if unlocked or unknown.

    Parameters
    ----------
    url
        A device path; of a URL nothing is known.
    """
    url = port_of(url)
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


def openers(url: str) -> list[int]:
    """Return the other processes that have a terminal open; the system reports all of them to root only.

    Parameters
    ----------
    url
        A device path; of a URL nothing is known.
    """
    url = port_of(url)
    found: list[int] = []
    with suppress(OSError):
        path = os.path.realpath(url)
        if "://" in url or not stat.S_ISCHR(os.stat(path).st_mode):
            return []
        for process in Path("/proc").iterdir():
            if process.name.isdigit() and int(process.name) != os.getpid() and _has_open(process, path):
                found.append(int(process.name))
    return found


def _has_open(process: Path, path: str) -> bool:
    with suppress(OSError):  # it has ended, or is another user's
        files = {entry.name: os.readlink(entry) for entry in (process / "fd").iterdir()}
        if path not in files.values():
            return False
        masters = [name for name, target in files.items() if target == "/dev/ptmx"]
        return not any(_is_master(process / "fdinfo" / name, path) for name in masters)
    return False


def _is_master(file: Path, path: str) -> bool:
    """Return whether an open pseudo-terminal master belongs to ``path``, so that its process is the device."""
    return f"tty-index:\t{path.rpartition('/')[2]}\n" in file.read_text()


def holder_of(url: str) -> str:
    """Return the holder of a terminal: the process that locked it, otherwise those that have it open; "" if unknown."""
    owner = lock_owner(url)
    return program_of(owner) if owner else opened_by(url)


def opened_by(url: str) -> str:
    """Return the names of the other programs that have a terminal open, at most three; "" for none."""
    return " and ".join(map(program_of, openers(url)[:3]))


def program_of(pid: int) -> str:
    """Return program name and number of a process, for example ``"steradian (process 4242)"``."""
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
        status = os.stat(port_of(path))
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


def forbidden(path: str) -> str:
    """Return one sentence with the reason why this user may not open a device file, and the remedy.

    Parameters
    ----------
    path
        A device path that exists.
    """
    try:
        status = os.stat(path)
        import grp
        import pwd
    except (OSError, ImportError):
        return f"no permission to open {path}"
    owner, group = _name(pwd.getpwuid, status.st_uid), _name(grp.getgrgid, status.st_gid)
    user = _name(pwd.getpwuid, os.geteuid())
    mode = stat.S_IMODE(status.st_mode)
    said = f"no permission to open {path} (owner {owner}, group {group}, mode {mode:o}) as {user}"
    if mode & 0o060 != 0o060 or status.st_gid == 0:
        return f"{said}: an administrator must give it, by a udev rule, a group that may read and write it and has you"
    return f"{said}: run 'sudo usermod -aG {group} {user}', then log in again"


def _name(look_up: Callable[[int], Any], number: int) -> str:
    try:
        return str(look_up(number)[0])
    except KeyError:  # a user or group without an entry, as in containers
        return str(number)
