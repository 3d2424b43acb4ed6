"""A scanner that falls silent, its program stopped in the midst of a scan, is named as such."""

import os
import signal
import sys
import threading
import time
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from acquisition_bench import Bench

from fabry_perot.simulator import launch
from steradian.storage.state_machines import DesiredScanState, ScanState


@pytest.mark.long
def test_scan_with_silent_scanner_changes_to_recovering(tmp_path):
    class Port:
        def url(self):
            return simulator.url

        present = url

        def close(self):
            pass

    with launch() as simulator:
        bench = Bench(tmp_path, Port())
        identifier = bench.queue(pulse_rate=5.0)
        thread = threading.Thread(target=bench.work.run_once)
        thread.start()
        try:
            state = lambda: bench.scans.get(identifier).state  # noqa: E731
            until(lambda: state() is ScanState.RUNNING)
            os.kill(simulator.pid, signal.SIGSTOP)
            until(lambda: state() is ScanState.RECOVERING)
            assert "silent" in bench.scans.get(identifier).history[-1]["why"]
        finally:
            os.kill(simulator.pid, signal.SIGCONT)
            bench.scans.set_desired_state(identifier, DesiredScanState.ABORTED, "seen enough")
            thread.join(60)
            bench.close()
    assert not thread.is_alive()


def until(condition):
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline, "it did not happen"
        time.sleep(0.05)
