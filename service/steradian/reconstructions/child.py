"""One reconstruction in a process of its own: ``python -m steradian.reconstructions.child``, started by a worker."""

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
        ``scan`` (path of the recording), ``output`` (folder for the results), ``parameters`` (of the reconstruction)
        and ``job`` (the job's own folder, put there by the worker).

    Returns
    -------
    dict
        The report, as plain JSON.
    """
    progress("loading", 0, 1)
    from steradian.reconstructions.job import reconstruct_scan
    from steradian.reconstructions.parameters import ReconstructionParameters

    parameters = ReconstructionParameters.create(**payload["parameters"])
    with JobDirectory(Path(payload["job"])).running():
        report = reconstruct_scan(Path(payload["scan"]), Path(payload["output"]), parameters, progress=progress)
    return asdict(report)


if __name__ == "__main__":
    child_main(work)
