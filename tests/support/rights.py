"""Processes that obey owners and modes also where tests run as root."""

import os
import shutil

import pytest

STRANGER = 12345
"""Number of a user to whom parts of a folder are given; it needs no name."""


def obeying(*command):
    """Return a command without root's right to pass over owners and modes; skipped where that cannot be had."""
    if os.name != "posix" or os.geteuid() or shutil.which("setpriv") is None:
        pytest.skip("needs root, which gives files to another user, and setpriv (Debian's util-linux)")
    lacks = "-dac_override,-dac_read_search,-fowner"
    return ["setpriv", f"--bounding-set={lacks}", "--inh-caps=-all", *map(str, command)]


def give_away(path, owner=STRANGER):
    """Give a file, or a folder with all that is in it, to another user; the others may read it alone."""
    for each in (path, *(path.rglob("*") if path.is_dir() else ())):
        os.chown(each, owner, owner)
        each.chmod(0o755 if each.is_dir() else 0o644)


def take_back(path):
    """Give it back to the user who runs the tests."""
    give_away(path, os.geteuid())
