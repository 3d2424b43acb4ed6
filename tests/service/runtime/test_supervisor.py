import itertools
import json
import os
import signal
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest

from steradian.core.settings import Settings
from steradian.runtime.heartbeat import Heartbeat
from steradian.runtime.supervisor import ManagedProcess, running_worker
from steradian.storage.data_dir.layout import DataDirectory, DataDirectoryInUse
from support.services import Service
from support.waiting import until


def test_managed_process_that_keeps_exiting_restarts_with_backoff(tmp_path):
    child = ManagedProcess("brief", ["true"], {"PATH": "/usr/bin:/bin"})
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


@pytest.mark.long
def test_a_worker_alone_owns_the_data_directory_while_its_block_lasts(tmp_path, monkeypatch):
    monkeypatch.setenv("STERADIAN_API_KEY", "a secret of the service")
    settings = Settings.create(data=tmp_path)
    beat = DataDirectory(tmp_path).heartbeat("worker-0")
    with running_worker(settings):
        with pytest.raises(DataDirectoryInUse), running_worker(settings):
            pass
        until(beat.exists)
        if sys.platform.startswith("linux"):
            process = Path(f"/proc/{json.loads(beat.read_text())['pid']}")
            assert b"a secret of the service" not in (process / "environ").read_bytes(), "it needs no key"
            assert "Umask:\t0077" in (process / "status").read_text(), "what it writes is for its user alone"
    with DataDirectory(tmp_path).lock():
        pass


@pytest.mark.skipif(sys.platform == "win32", reason="a process is stopped by a signal")
@pytest.mark.long
@pytest.mark.timeout(400)
def test_processes_that_are_stopped_are_named_and_a_stopped_api_is_replaced(tmp_path):
    service = Service(tmp_path).start()
    said = lambda: service.log.read_text()  # noqa: E731
    try:
        until(lambda: get(f"{service.url}/readyz") == 200)

        acquisition = service.pid_of("acquisition")
        os.kill(acquisition, signal.SIGSTOP)
        until(lambda: "acquisition runs but has shown no sign of life" in said())
        assert get(f"{service.url}/readyz") == 503
        os.kill(acquisition, signal.SIGCONT)
        until(lambda: "acquisition shows signs of life again" in said())

        api = service.pid_of("api")
        os.kill(api, signal.SIGSTOP)
        until(lambda: "api runs but has shown no sign of life" in said())
        until(lambda: service.pid_of("api") != api and get(f"{service.url}/healthz") == 200)
        assert "and is replaced" in said()
        assert service.pid_of("acquisition") == acquisition
    finally:
        service.close()


@pytest.mark.long
def test_service_exit_removes_only_its_own_heartbeat_files(tmp_path):
    data, service = DataDirectory(tmp_path), Service(tmp_path).start()
    try:
        until(lambda: data.heartbeat("worker-0").exists() and data.heartbeat("acquisition").exists())
        data.heartbeat("elsewhere-0").write_text('{"pid": 1}')
    finally:
        service.close()
    assert [path.name for path in (tmp_path / "run").glob("*.json")] == ["elsewhere-0.json"]


def test_heartbeat_file_that_was_deleted_is_recreated(tmp_path):
    sign = tmp_path / "run" / "other-0.json"
    with Heartbeat(sign):
        for _ in range(2):
            sign.unlink()
            until(sign.exists)


def get(url):
    try:
        with urllib.request.urlopen(url, timeout=5) as answer:  # noqa: S310
            return answer.status
    except urllib.error.HTTPError as error:
        return error.code
    except OSError:
        return 0
