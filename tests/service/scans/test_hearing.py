"""Wishes to end a scan while its scanner does not answer: at once, and not when the last of all tries is over."""

import socket
import sys
import threading
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from acquisition_bench import Bench, Port

from fabry_perot.simulator import launch
from fabry_perot.wire.constants import Operation, Type
from fabry_perot.wire.framing import Deframer, encode_frame
from fabry_perot.wire.messages import REQUEST_HEAD
from steradian.scans.acquisition.run import run_scan
from steradian.scans.acquisition.session_control import Command, SessionControl
from steradian.storage.state_machines import DesiredScanState, ScanState
from support.waiting import until

FEW = 30
"""Requests within which a wish is heard; all tries of a sweep are a hundred."""


class Deaf:
    """A line to a scanner that loses all requests of some kinds, or all that the host says."""

    def __init__(self, scanner, lost):
        self._scanner, self._lost, self.dropped = scanner, lost, 0
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"socket://127.0.0.1:{self._listener.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self):
        self._listener.close()

    def _accept(self):
        with suppress(OSError):
            while True:
                host, _ = self._listener.accept()
                where = self._scanner.url.removeprefix("socket://").split(":")
                device = socket.create_connection((where[0], int(where[1])))
                threading.Thread(target=self._pass, args=(device, host, bytes), daemon=True).start()
                threading.Thread(target=self._pass, args=(host, device, self._filter()), daemon=True).start()

    def _pass(self, source, target, change):
        with suppress(OSError):
            while data := source.recv(65536):
                target.sendall(change(data))
        for each in (source, target):
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)

    def _filter(self):
        deframer = Deframer()
        return lambda data: b"".join(encode_frame(one) for one in deframer.feed(data) if self._is_heard(one))

    def _is_heard(self, frame):
        is_lost = self._lost is None
        if frame.type == Type.REQ and not is_lost:
            is_lost = REQUEST_HEAD.unpack_from(frame.payload)[1] in self._lost
        self.dropped += is_lost
        return not is_lost


@contextmanager
def deaf(*lost):
    """A line that loses these requests; without any, all that the host says."""
    with launch(tcp="127.0.0.1:0", speed=20.0) as scanner:
        line = Deaf(scanner, lost or None)
        try:
            yield line
        finally:
            line.close()


@pytest.mark.parametrize("desired", [DesiredScanState.STOPPED, DesiredScanState.ABORTED])
def test_acquisition_end_request_while_arming_on_bad_line_ends_promptly(tmp_path, desired):
    with deaf(Operation.TUNE_SCAN) as line:
        bench = Bench(tmp_path, Port(line.url))
        scan = bench.queue()

        def act():
            bench.until(scan, ScanState.ARMING)
            until(lambda: line.dropped)
            bench.scans.set_desired_state(scan, desired, "enough")

        bench.meanwhile(act)
        assert bench.scans.get(scan).state is ScanState.ABORTED, "nothing was measured"
        assert line.dropped < FEW
        bench.close()


def test_acquisition_stop_request_while_connecting_ends_promptly(tmp_path):
    with deaf() as line:
        bench = Bench(tmp_path, Port(line.url))
        scan = bench.queue()

        def act():
            until(lambda: line.dropped)
            bench.scans.set_desired_state(scan, DesiredScanState.STOPPED, "enough")

        bench.meanwhile(act)
        assert bench.scans.get(scan).state is ScanState.ABORTED
        assert bench.scans.get(scan).error_code is None
        assert line.dropped < 15, "20 tries are all"
        bench.close()


def test_run_scan_shutdown_during_plan_upload_returns_stopped(tmp_path):
    class Leaves(SessionControl):
        def command(self):
            return Command.SHUTDOWN if line.dropped else Command.RUN

    with deaf(Operation.PLAN_NEW) as line:
        bench = Bench(tmp_path / "data")
        plan = bench.plans.load(bench.scans.get(bench.queue()).plan_id)
        summary = run_scan(plan, line.url, tmp_path / "a.h5", control=Leaves())
        assert (summary.end, summary.stored) == ("stopped", 0)
        bench.close()
