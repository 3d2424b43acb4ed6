"""Reconstructions, one after another, in a process of a worker: ``python -m steradian.reconstructions.child``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from steradian.progress import Progress
from steradian.storage.job_process import child_main
from steradian.storage.paths import JobDirectory


def work(payload: dict[str, Any], progress: Progress) -> dict[str, Any]:
    """Reconstruct what the payload names.

    Parameters
    ----------
    payload
        ``scan`` (path of the recording), ``output`` (folder for the results), ``parameters`` (of the reconstruction);
        ``data`` (the data directory, to which the paths are relative) and ``job`` (the job's own folder), put there
        by the worker.

    Returns
    -------
    dict
        The report, as plain JSON.
    """
    progress("loading", 0, 1)
    from steradian.reconstructions.job import reconstruct_scan
    from steradian.reconstructions.parameters import ReconstructionParameters

    parameters = ReconstructionParameters.create(**payload["parameters"])
    data = Path(payload["data"])
    with JobDirectory(Path(payload["job"])).running():
        report = reconstruct_scan(data / payload["scan"], data / payload["output"], parameters, progress=progress)
    return asdict(report)


if __name__ == "__main__":
    child_main(work)
