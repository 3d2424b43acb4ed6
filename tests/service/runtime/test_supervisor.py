import itertools
import json
import sys
import time
from pathlib import Path

import pytest

from steradian.runtime.supervisor import Child, running_worker
from steradian.settings import Settings
from steradian.storage.paths import DataDirectory, DataDirectoryInUse


def test_a_child_that_keeps_ending_is_started_after_ever_longer_pauses(tmp_path):
    child = Child("brief", ["true"], {"PATH": "/usr/bin:/bin"})
    starts, now = [], 0.0
    for _ in range(400):
        was = child.process
        child.tend(now)
        if child.process is not None and child.process is not was:
            starts.append(now)
            child.process.wait()
        now += 0.1
    child.end(time.monotonic())
    pauses = [round(b - a, 1) for a, b in itertools.pairwise(starts)]
    assert pauses[:4] == pytest.approx([1.0, 2.0, 4.0, 8.0], abs=0.35)


def test_a_worker_alone_owns_the_data_directory_while_its_block_lasts(tmp_path, monkeypatch):
    monkeypatch.setenv("STERADIAN_API_KEY", "a secret of the service")
    settings = Settings.create(data=tmp_path)
    beat = DataDirectory(tmp_path).heartbeat("worker-0")
    with running_worker(settings):
        with pytest.raises(DataDirectoryInUse), running_worker(settings):
            pass
        deadline = time.monotonic() + 60
        while not beat.exists():
            assert time.monotonic() < deadline
            time.sleep(0.05)
        if sys.platform.startswith("linux"):
            process = Path(f"/proc/{json.loads(beat.read_text())['pid']}")
            assert b"a secret of the service" not in (process / "environ").read_bytes(), "it needs no key"
            assert "Umask:\t0077" in (process / "status").read_text(), "what it writes is for its user alone"
    with DataDirectory(tmp_path).lock():
        pass
