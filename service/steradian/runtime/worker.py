"""The worker process: ``python -m steradian.runtime.worker SLOT``."""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading

from steradian.core.exit_with_parent import end_with_stdin
from steradian.core.logging_config import configure_logging
from steradian.core.settings import Settings
from steradian.jobs.registry import KINDS
from steradian.jobs.worker.memory_tuning import share_one_heap
from steradian.jobs.worker.readiness import join
from steradian.reconstructions.warmup import compile_ahead
from steradian.runtime.gpu import gpu_of_this_machine
from steradian.runtime.heartbeat import Heartbeat
from steradian.storage.data_dir.layout import DataDirectory

_log = logging.getLogger(__name__)
QUIET = 5.0
"""Seconds after which the first worker has compiled what jobs need: a service that begins has its processors busy."""
CHILD = (sys.executable, "-P", "-m", "steradian.jobs.worker.child")


def main(slot: int) -> None:
    """Entry point of worker number ``slot``; the environment contains its settings."""
    share_one_heap()  # before any thread begins
    settings = Settings.create()
    configure_logging(settings, settings.executor(slot))
    stop = threading.Thread(target=end_with_stdin, args=(lambda: os.kill(os.getpid(), signal.SIGTERM),), daemon=True)
    stop.start()
    join(settings)
    with Heartbeat(DataDirectory(settings.data).heartbeat(settings.executor(slot))) as sign:
        gpu = gpu_of_this_machine()  # which may take long where a driver hangs
        _log.info("reconstructs on %s", gpu or "the processor")
        if gpu is not None:
            sign.tell_gpu(gpu)
        if slot == 0:
            later = threading.Timer(QUIET, compile_ahead)
            later.daemon = True  # its process ends with this one
            later.start()
        from steradian.jobs.queue.matching import Capabilities
        from steradian.jobs.worker.main import run_worker

        has = Capabilities.of_this_machine(settings, gpu)
        run_worker(settings, slot, dict.fromkeys(KINDS, CHILD), has)


if __name__ == "__main__":
    main(int(sys.argv[1]))
