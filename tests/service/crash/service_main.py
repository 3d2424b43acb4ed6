"""The real service, whose workers also take the jobs of ``echo_job.py``: ``service_main.py serve | worker``."""

import signal
import sys
import threading
from pathlib import Path

from steradian.core.settings import Settings
from steradian.runtime import supervisor

HERE = Path(__file__)


def worker_child(settings, slot, output):
    command = [sys.executable, str(HERE.with_name("worker_main.py")), str(slot)]
    return supervisor.ManagedProcess(settings.worker_slot_name(slot), command, settings.environment(), output=output)


if __name__ == "__main__":
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    supervisor._worker = worker_child
    run = {"serve": supervisor.run_service, "worker": supervisor.run_workers}[sys.argv[1]]
    run(Settings.create(), lambda line: print(line, flush=True), stop)
