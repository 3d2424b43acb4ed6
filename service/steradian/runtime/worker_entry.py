"""Worker process (``python -m steradian.runtime.worker_entry SLOT``): runs jobs of the queue."""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading

from steradian.core.child_process import exit_when_stdin_closes
from steradian.core.logging_config import configure_logging
from steradian.core.settings import Settings
from steradian.jobs.registry import JOB_TYPES
from steradian.jobs.worker.memory_tuning import limit_malloc_arenas
from steradian.jobs.worker.startup_check import wait_until_ready
from steradian.reconstructions.warmup import warm_up
from steradian.runtime.gpu_detection import detect_gpu
from steradian.runtime.heartbeat import Heartbeat
from steradian.storage.data_dir.layout import DataDirectory

_log = logging.getLogger(__name__)
QUIET_LOGGERS = 5.0
"""Seconds after which the first worker has compiled what jobs need: a service that begins has its processors busy."""
CHILD_COMMAND = (sys.executable, "-P", "-m", "steradian.jobs.worker.child")


def main(slot: int) -> None:
    """Run the worker with number ``slot``, with settings from environment variables."""
    limit_malloc_arenas()  # before any thread begins
    settings = Settings.create()
    configure_logging(settings, settings.worker_slot_name(slot))
    stop = threading.Thread(
        target=exit_when_stdin_closes, args=(lambda: os.kill(os.getpid(), signal.SIGTERM),), daemon=True
    )
    stop.start()
    wait_until_ready(settings)
    with Heartbeat(DataDirectory(settings.data).heartbeat(settings.worker_slot_name(slot))) as sign:
        gpu = detect_gpu()  # which may take long where a driver hangs
        _log.info("reconstructs on %s", gpu or "the processor")
        if gpu is not None:
            sign.set_gpu(gpu)
        if slot == 0:
            later = threading.Timer(QUIET_LOGGERS, warm_up)
            later.daemon = True  # its process ends with this one
            later.start()
        from steradian.jobs.queue.matching import Capabilities
        from steradian.jobs.worker.main import run_worker

        has = Capabilities.of_this_machine(settings, gpu)
        run_worker(settings, slot, dict.fromkeys(JOB_TYPES, CHILD_COMMAND), has)


if __name__ == "__main__":
    main(int(sys.argv[1]))
