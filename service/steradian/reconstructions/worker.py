"""The worker process: ``python -m steradian.reconstructions.worker SLOT``, and the jobs it takes."""

from __future__ import annotations

import os
import signal
import sys
import threading
from pathlib import Path
from typing import Any

from steradian.reconstructions.kinds import KINDS, RECONSTRUCTION
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.settings import Settings
from steradian.storage.heartbeat import Heartbeat
from steradian.storage.job_process import end_with_stdin
from steradian.storage.jobs import JobRequest
from steradian.storage.logs import configure_logging
from steradian.storage.paths import DataDirectory

CHILD = (sys.executable, "-P", "-m", "steradian.reconstructions.child")


def reconstruction_job(
    job_id: str,
    settings: Settings,
    scan: Path,
    parameters: ReconstructionParameters,
    output: Path | None = None,
    *,
    frame: int | None = None,
    **about: Any,
) -> JobRequest:
    """Describe a reconstruction as a job.

    Parameters
    ----------
    scan
        The recording.
    output
        Folder for the results; by default the job's own in the data directory.
    frame
        Which frame of the recording, if it has several.
    **about
        ``scan_id``, ``batch_id``; and ``priority``, ``timeout``, ``principal`` of the :class:`JobRequest`.

    Notes
    -----
    Paths below the data directory are sent relative to it, so that a worker elsewhere may have it mounted elsewhere.
    """
    data = DataDirectory(settings.data)
    payload: dict[str, Any] = {
        "scan": _portable(scan, data.root),
        "output": _portable(output or data.job(job_id).root, data.root),
        "parameters": parameters.model_dump(mode="json"),
        "frame": frame,
        **{name: about.pop(name) for name in ("scan_id", "batch_id") if name in about},
    }
    return JobRequest(job_id, RECONSTRUCTION, payload, **about)


def _portable(path: Path, root: Path) -> str:
    path, root = path.absolute(), root.absolute()
    return str(path.relative_to(root) if path.is_relative_to(root) else path)


def main(slot: int) -> None:
    """Be worker number ``slot`` of the service that the environment describes."""
    settings = Settings.create()
    configure_logging(settings, settings.executor(slot))
    stop = threading.Thread(target=end_with_stdin, args=(lambda: os.kill(os.getpid(), signal.SIGTERM),), daemon=True)
    with Heartbeat(DataDirectory(settings.data).heartbeat(settings.executor(slot))):
        stop.start()
        from steradian.storage.queue import run_worker

        run_worker(settings, slot, dict.fromkeys(KINDS, CHILD))


if __name__ == "__main__":
    main(int(sys.argv[1]))
