"""Reconstructions as jobs for the queue."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from steradian.jobs.kinds import RECONSTRUCTION
from steradian.jobs.model import JobRequest
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.settings import Settings
from steradian.storage.paths import DataDirectory


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
