"""Memory: what there is for a reconstruction, and the refusal of one that needs more."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from steradian.errors import InvalidInput

_MINE, _GROUPS = Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")


def require(needed: int, limit: int | None, shape: tuple[int, ...], images: int = 1) -> None:
    """Refuse a reconstruction that needs more than ``limit`` bytes, or than there are; before they are taken.

    Parameters
    ----------
    needed
        Bytes, or a lower bound of them.
    limit
        What the user allowed; None: what is available.
    shape
        Of the image, for the message.
    images
        How many of them are kept.

    Raises
    ------
    InvalidInput
        With both numbers: of ``memory_limit`` where one was given, else of ``modes``, the most likely cause, or of
        ``traces`` where they make several images.
    """
    image = " × ".join(map(str, shape))
    if limit is not None:
        if needed > limit:
            which = "this image" if images == 1 else f"these {images} images"
            raise InvalidInput("memory_limit", limit, f"at least {needed} bytes for {which} of {image} voxels")
        return
    there = available()
    if there is not None and needed > there and images > 1:
        raise InvalidInput(
            "traces",
            f"{images} sets",
            f"what the available {there} bytes of memory can hold; as many images of {image} voxels need at least "
            f"{needed} (fewer sets at once need less)",
        )
    if there is not None and needed > there:
        raise InvalidInput(
            "modes",
            " × ".join(map(str, shape[:-1])),
            f"what the available {there} bytes of memory can hold; {image} voxels need at least {needed} "
            f"(fewer modes, a depth_range or less upsampling need less)",
        )


def available() -> int | None:
    """Bytes that this process may still take without swapping; None where the system does not say.

    The least of what the machine has to spare, what the control groups of this process are still allowed (containers,
    batch systems), and the limit of its address space (``ulimit -v``).
    """
    rooms = [room for room in (_of_machine(), *room_of_groups(_MINE, _GROUPS), _of_address_space()) if room is not None]
    return max(0, min(rooms)) if rooms else None


def _of_machine() -> int | None:
    for line in _lines(Path("/proc/meminfo")):
        if line.startswith("MemAvailable:"):
            return 1024 * int(line.split()[1])
    try:  # all there is, where the system tells no more
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # Windows
        return None


def room_of_groups(mine: Path, groups: Path) -> Iterator[int]:
    """Room in the control groups of a process, told by the file ``mine``, and in those around them; version 2 or 1."""
    for line in _lines(mine):
        _, controllers, path = line.split(":", 2)
        if controllers == "":
            root, most, used = groups, "memory.max", "memory.current"
        elif "memory" in controllers.split(","):
            root, most, used = groups / "memory", "memory.limit_in_bytes", "memory.usage_in_bytes"
        else:
            continue
        inner = PurePosixPath(path.lstrip("/"))
        for group in (inner, *inner.parents):  # within a container the path may be the host's: then only the root is
            limit, taken = (_number(root / group / name) for name in (most, used))
            if limit is not None and taken is not None:
                yield limit - taken + _cached(root / group / "memory.stat")


def _cached(statistics: Path) -> int:
    """Bytes of files, given back when they are needed."""
    known = dict(line.split(maxsplit=1) for line in _lines(statistics))
    # version 1 tells of the group alone, and with "total_" of those within it as well
    return sum(int(known.get(f"total_{kind}", known.get(kind, 0))) for kind in ("inactive_file", "active_file"))


def _of_address_space() -> int | None:
    try:
        import resource
    except ImportError:  # Windows
        return None
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    pages = _lines(Path("/proc/self/statm"))
    if limit == resource.RLIM_INFINITY or not pages:
        return None
    return limit - int(pages[0].split()[0]) * resource.getpagesize()


def _number(path: Path) -> int | None:
    lines = _lines(path)
    return int(lines[0]) if lines and lines[0].isdigit() else None


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text().splitlines()
    except OSError:
        return []
