"""Memory and CPUs available to this process, within its cgroup limits."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

_MINE, _GROUPS = Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")


def total_memory() -> int | None:
    """Return the memory of the machine or cgroup limit in bytes; None where the system does not report it.

    What the machine has, or the limit of a control group (container, batch system) where that is less.
    """
    machine = _figure("MemTotal:") or _physical()
    limits = [limit for limit, _, _ in _limits(_MINE, _GROUPS)]
    rooms = [room for room in (machine, *limits) if room is not None]
    return min(rooms) if rooms else None


def available_memory() -> int | None:
    """Return the bytes that this process can allocate without swapping; None where the system does not report it.

    The least of what the machine has to spare, what the control groups of this process are still allowed (containers,
    batch systems), and the limit of its address space (``ulimit -v``).
    """
    rooms = [
        room
        for room in (_of_machine(), *cgroup_memory_headroom(_MINE, _GROUPS), _of_address_space())
        if room is not None
    ]
    return max(0, min(rooms)) if rooms else None


def cpu_count(mine: Path = _MINE, groups: Path = _GROUPS) -> int:
    """Return the CPUs available to this process within CPU affinity and cgroup quota, at least one."""
    try:
        found: float = len(os.sched_getaffinity(0))
    except AttributeError:  # not on macOS or Windows
        found = os.cpu_count() or 1
    for group in _of_process(mine, groups, "cpu"):
        quota, _, period = "".join(_lines(group / "cpu.max")).partition(" ")
        if not quota.isdigit():  # version 1, or no limit
            quota, period = ("".join(_lines(group / f"cpu.cfs_{name}_us")) for name in ("quota", "period"))
        if quota.isdigit() and period.isdigit():
            found = min(found, int(quota) / int(period))
    return max(1, int(found))


def cgroup_memory_headroom(mine: Path, groups: Path) -> Iterator[int]:
    """Yield the bytes left below the memory limit of this process's cgroup and of each parent (v1 and v2)."""
    for limit, taken, statistics in _limits(mine, groups):
        if taken is not None:
            yield limit - taken + _cached(statistics)


def _of_machine() -> int | None:
    available = _figure("MemAvailable:")
    return _physical() if available is None else available  # all there is, where the system tells no more


def _figure(name: str) -> int | None:
    for line in _lines(Path("/proc/meminfo")):
        if line.startswith(name):
            return 1024 * int(line.split()[1])
    return None


def _physical() -> int | None:
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # Windows
        return None


def _limits(mine: Path, groups: Path) -> Iterator[tuple[int, int | None, Path]]:
    """Yield memory limit, usage and statistics file of each cgroup (v1 and v2)."""
    for group in _of_process(mine, groups, "memory"):
        for most, used in (("memory.max", "memory.current"), ("memory.limit_in_bytes", "memory.usage_in_bytes")):
            limit, taken = _number(group / most), _number(group / used)
            if limit is not None:
                yield limit, taken, group / "memory.stat"


def _of_process(mine: Path, groups: Path, controller: str) -> Iterator[Path]:
    """Yield the folders of the cgroups named in the file ``mine`` and of their parents, innermost first."""
    for line in _lines(mine):
        _, controllers, path = line.split(":", 2)
        if controllers == "" or controller in controllers.split(","):
            root = groups / controller if controllers else groups
            inner = PurePosixPath(path.lstrip("/"))
            # within a container the path may be the host's: then only the root is there
            yield from (root / group for group in (inner, *inner.parents))


def _cached(statistics: Path) -> int:
    """Return the bytes of a cgroup's file cache, which the kernel reclaims on demand."""
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
