"""Heartbeat files: what is read while a process writes them."""

import json
import threading

import pytest

from steradian.runtime.heartbeat import Heartbeat


@pytest.mark.long
def test_heartbeat_file_rewrite_is_atomic_for_readers(tmp_path):
    path, over, read = tmp_path / "run" / "worker-0.json", threading.Event(), []

    def read_on():
        while not over.is_set():
            read.append(path.read_text())

    with Heartbeat(path) as beat:
        reader = threading.Thread(target=read_on)
        reader.start()
        for number in range(500):
            beat.set_gpu(f"GPU {number}")
        over.set()
        reader.join()
        assert json.loads(path.read_text())["gpu"] == "GPU 499"
    assert [text for text in read if not text.endswith("}")] == []
    assert list(path.parent.iterdir()) == []
