"""Atomic file writes: write to a temporary name, fsync, rename.

A job may be started again while an earlier start of it still lives somewhere, cut off. Each start therefore signs its
drafts, so that two of them never write into one, and asks before a draft takes the place of a result.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

DRAFT_SUFFIX = ".new"
_signature = ""
_check: Callable[[], object] = bool


@contextmanager
def atomic_write(path: Path, *, keep_ending: bool = False) -> Iterator[Path]:
    """Yield a temporary path to write a file or folder to, renamed to ``path`` at the end of the block.

    Parameters
    ----------
    keep_ending
        Whether the path must end like ``path``, because its writer chooses a format by that.

    Raises
    ------
    StaleFence
        When this process works for a start of a job that is not the newest any more; ``path`` is then untouched.
    """
    name = (
        f".{path.stem}{_signature}{DRAFT_SUFFIX}{path.suffix}"
        if keep_ending
        else f"{path.name}{_signature}{DRAFT_SUFFIX}"
    )
    beside = path.with_name(name)
    remove(beside)
    try:
        yield beside
        _check()
        beside.replace(path)
    finally:
        remove(beside)


@contextmanager
def fenced_drafts(name: str, check: Callable[[], object]) -> Iterator[None]:
    """Give this process's temporary files a unique name and call ``check`` before each rename (fencing)."""
    global _signature, _check
    before = _signature, _check
    _signature, _check = f".{name}", check
    try:
        yield
    finally:
        _signature, _check = before


def remove_older(folder: Path, oldest: float, names: str = "*") -> None:
    """Remove the files of a folder last modified before a time (s since 1970)."""
    for path in folder.glob(names):
        with suppress(FileNotFoundError):  # a draft has got its name, or somebody else removes it
            if path.stat().st_mtime < oldest:
                path.unlink()


def remove_drafts(folder: Path) -> None:
    """Remove the temporary files that killed processes left in a folder."""
    for left in folder.glob(f"*{DRAFT_SUFFIX}*"):
        remove(left)


def write_durably(path: Path, text: str) -> None:
    """Write a small text file atomically and sync it to disk, so that it survives a power cut."""
    with atomic_write(path) as beside, beside.open("w") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Sync a folder to disk, so that renames in it survive a power cut."""
    if os.name != "posix":  # elsewhere a folder cannot be opened, and renames are journalled
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def remove(path: Path) -> None:
    """Remove a file or folder, if it exists."""
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
