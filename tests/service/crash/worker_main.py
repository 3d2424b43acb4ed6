"""A worker like the service's own that also takes the jobs of ``echo_job.py``."""

import os
import signal
import sys
import threading
from pathlib import Path

from steradian.core.child_process import exit_when_stdin_closes
from steradian.core.logging_config import configure_logging
from steradian.core.settings import Settings
from steradian.jobs.worker.main import run_worker
from steradian.jobs.worker.startup_check import wait_until_ready
from steradian.runtime.heartbeat import Heartbeat
from steradian.storage.data_dir.layout import DataDirectory

if __name__ == "__main__":
    settings, slot = Settings.create(), int(sys.argv[1])
    configure_logging(settings, settings.worker_slot_name(slot))
    threading.Thread(
        target=exit_when_stdin_closes, args=(lambda: os.kill(os.getpid(), signal.SIGTERM),), daemon=True
    ).start()
    echo = Path(__file__).parents[1] / "jobs" / "echo_job.py"
    wait_until_ready(settings)
    with Heartbeat(DataDirectory(settings.data).heartbeat(settings.worker_slot_name(slot))):
        run_worker(
            settings,
            slot,
            {
                "echo": [sys.executable, str(echo)],
                "reconstruction": [sys.executable, "-m", "steradian.jobs.worker.child"],
            },
        )
