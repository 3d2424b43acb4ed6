"""The worker process: ``python -m steradian.reconstructions.worker SLOT``, and the jobs it takes."""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
from pathlib import Path

from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.settings import Settings
from steradian.storage.heartbeat import Heartbeat
from steradian.storage.job_process import end_with_stdin
from steradian.storage.jobs import JobRequest
from steradian.storage.paths import DataDirectory

RECONSTRUCTION = "reconstruction"


def reconstruction_job(
    job_id: str, settings: Settings, scan: Path, parameters: ReconstructionParameters, output: Path | None = None
) -> JobRequest:
    """Describe a reconstruction as a job.

    Parameters
    ----------
    scan
        The recording.
    output
        Folder for the results; by default the job's own in the data directory.
    """
    folder = DataDirectory(settings.data).job(job_id).root
    payload = {
        "scan": str(scan.absolute()),
        "output": str((output or folder).absolute()),
        "parameters": parameters.model_dump(mode="json"),
    }
    return JobRequest(job_id, RECONSTRUCTION, payload)


def main(slot: int) -> None:
    """Be worker number ``slot`` of the service that the environment describes."""
    settings = Settings.create()
    logging.basicConfig(level=settings.log_level, format="%(asctime)s %(levelname)s worker %(message)s")
    stop = threading.Thread(target=end_with_stdin, args=(lambda: os.kill(os.getpid(), signal.SIGTERM),), daemon=True)
    with Heartbeat(DataDirectory(settings.data).heartbeat(f"worker-{slot}")):
        stop.start()
        from steradian.storage.queue import run_worker

        run_worker(settings, slot, {RECONSTRUCTION: [sys.executable, "-m", "steradian.reconstructions.child"]})


if __name__ == "__main__":
    main(int(sys.argv[1]))
