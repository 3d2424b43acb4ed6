"""Check of write permissions in the data folder by owners and modes, without changing them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from shlex import quote
from typing import Final

from steradian.core.exceptions import FolderNotWritable
from steradian.storage.data_dir.layout import DATABASE_FILE, FOLDERS, DataDirectory

ALSO: Final = ("cache", "emergency-stop")
"""Folders that are there in some cases only."""
FILES: Final = (*("lock", "identity"), *(DATABASE_FILE + end for end in ("", "-wal", "-shm", "-journal")))
WITHIN: Final = ("emergency-stop", "jobs", "run", "scans", "uploads")
"""Folders of which also what lies in them is looked at."""


def require_writable(data: DataDirectory, within: tuple[str, ...] = WITHIN) -> None:
    """Raise :class:`FolderNotWritable` if an existing part of a data folder is not writable.

    Parameters
    ----------
    data
        The folder.
    within
        Folders whose entries are checked as well.

    Raises
    ------
    FolderNotWritable
        For the first such part, with its path, owner and the remedy.
    """
    for path in _all_parts(data, within):
        if (why := _why_not(path)) is not None:
            raise FolderNotWritable(f"{path} {why[0]}; {why[1].format(data=quote(str(data.root.absolute())))}")


def unwritable_part(data: DataDirectory) -> str | None:
    """Return the first part of the data folder that is not writable, with the reason; ``None`` if all are.

    The text contains the path relative to the data folder.
    """
    for path in _parts(data):
        if (why := _why_not(path)) is not None:
            return f"{_name(path, data)} {why[0]}"
    return None


def unwritable_jobs(data: DataDirectory) -> str | None:
    """Return the reason why the folder of jobs is not writable; ``None`` if it is."""
    path = data.root.absolute() / "jobs"
    return None if (why := _why_not(path)) is None else f"{_name(path, data)} {why[0]}"


def unwritable_job(data: DataDirectory, job_id: str) -> str | None:
    """Return the reason why a job's folder or log is not writable; ``None`` if it is, or does not exist yet."""
    folder = data.job(job_id)
    for path in (folder.root, folder.log, folder.root / "lock", folder.root / "start"):
        if (why := _why_not(path)) is not None:
            return f"{_name(path, data)} {why[0]}"
    return None


def can_write(path: Path) -> bool:
    """Return whether this process can write a file and its folder, or a folder."""
    return all(_why_not(each) is None for each in ((path,) if path.is_dir() else (path, path.parent)))


def _name(path: Path, data: DataDirectory) -> str:
    root = data.root.absolute()
    return "the data folder" if path == root else path.relative_to(root).as_posix()


def _parts(data: DataDirectory) -> Iterator[Path]:
    root = data.root.absolute()
    yield root
    yield from (root / name for name in (*FILES, *FOLDERS, *ALSO))


def _all_parts(data: DataDirectory, within: tuple[str, ...]) -> Iterator[Path]:
    yield from _parts(data)
    for name in within:
        if os.name != "posix":
            return
        with suppress(OSError), os.scandir(data.root.absolute() / name) as found:
            # What the process owns may be closed on purpose, as an archived scan is; others are a file system's own.
            yield from (Path(each.path) for each in found if not (_is_foreign(each.name) or _is_own(Path(each.path))))


def _is_foreign(name: str) -> bool:
    return name == "lost+found" or name.startswith((".", "@"))


def _is_own(path: Path) -> bool:
    try:
        return path.lstat().st_uid == os.geteuid()
    except OSError:
        return True


def _why_not(path: Path) -> tuple[str, str] | None:
    """Return the reason why a path is not writable, with the remedy; ``None`` if it is writable or does not exist."""
    if os.name != "posix":
        return None
    try:
        about = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        return f"cannot be inspected ({error.strerror})", "the folders above it must be open to the service's user"
    is_folder = path.is_dir()
    wanted = os.R_OK | os.W_OK | (os.X_OK if is_folder else 0)
    differs = (os.geteuid(), os.getegid()) != (os.getuid(), os.getgid())
    effective = differs and os.access in os.supports_effective_ids  # which some filters of system calls refuse
    if os.access(path, wanted, effective_ids=effective):
        return None
    with suppress(OSError):
        if os.statvfs(path).f_flag & os.ST_RDONLY:
            return "is on a file system that is mounted read-only", "mount it writable"
    me = os.geteuid()
    if about.st_uid == me:
        return f"is closed to its own user by its mode {about.st_mode & 0o777:o}", "`chmod -R u+rwX {data}` opens it"
    who = f"belongs to {_user(about.st_uid)} and cannot be written by this process's user {_user(me)}"
    return who, f"`chown -R {_user_name(me)} {{data}}`, as root, mends it"


def _user(number: int) -> str:
    name = _user_name(number)
    return f"{name} ({number})" if name != str(number) else name


def _user_name(number: int) -> str:
    import pwd  # of POSIX systems alone

    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:
        return str(number)
