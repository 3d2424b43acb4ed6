"""A small disk; skipped where none can be mounted."""

import contextlib
import os
import shutil
import subprocess

import pytest


@contextlib.contextmanager
def small_disk(folder):
    """Mount a disk of 64 MiB."""
    if os.geteuid() or shutil.which("mount") is None:
        pytest.skip("needs root to mount a small file system: run as root, or in the container")
    folder.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64m", "tmpfs", str(folder)], capture_output=True).returncode:
        pytest.skip("needs the right to mount a small file system: in a container --cap-add SYS_ADMIN")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)
