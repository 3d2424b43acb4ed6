"""Processes as the system's /proc shows them."""

import os
from pathlib import Path


def parent_of(pid):
    """The process that started one; None when it has ended, though nobody may have been told yet."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return None if fields[0] == "Z" else int(fields[1])


def children_of(pid):
    """Those that a process started."""
    pids = [int(path.name) for path in Path("/proc").iterdir() if path.name.isdecimal()]
    return [child for child in pids if parent_of(child) == pid]


def tree_of(pid):
    """Those that a process started, and those that they started."""
    found = [pid]
    for each in found:
        found += children_of(each)
    return found[1:]


def are_gone(pids):
    """Whether all of them have ended."""
    return all(parent_of(pid) is None for pid in pids)


def runs(pid, word):
    """Whether a word stands in the command of a process."""
    try:
        return word in Path(f"/proc/{pid}/cmdline").read_text()
    except OSError:
        return False


def processor_seconds(pid):
    """Processor time that a process has taken, in s; 0 when it has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")


def resident(pid):
    """Bytes of memory of a process; 0 when it has ended."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    except OSError:
        return 0
    return 0 if parent_of(pid) is None else pages * os.sysconf("SC_PAGE_SIZE")
