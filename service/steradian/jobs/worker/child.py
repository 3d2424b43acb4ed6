"""Child process of a worker, which runs jobs one after another."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from steradian.core.atomic_files import fenced_drafts
from steradian.core.exceptions import InvalidInput
from steradian.core.logging_config import configure_logging
from steradian.core.progress import Progress
from steradian.core.settings import Settings
from steradian.jobs.worker.process import child_main
from steradian.storage.blobs.interface import BlobStore, FolderBlobStore
from steradian.storage.data_dir.job_directory import JobDirectory
from steradian.storage.data_dir.layout import DataDirectory

if TYPE_CHECKING:
    from steradian.reconstructions.pipeline.plan_cache import PlanCache

_log = logging.getLogger("steradian.jobs.worker.child")  # whatever this module is called when it is run


def run_job(payload: dict[str, Any], progress: Progress, *, kept: list[PlanCache]) -> dict[str, Any]:
    """Run the handler of a job's kind in the child process and return its report.

    Parameters
    ----------
    payload
        ``kind`` of the job (:data:`steradian.jobs.registry.JOB_TYPES`) and its ``request``, as the ledger has them, the
        ``principal`` who asked, ``data`` (the data directory), ``job`` (the job's own folder), ``start`` (the number
        of this start) and ``store`` (whether the environment names one).
    kept
        Where the plans of earlier jobs are; empty before the first one.

    Returns
    -------
    dict
        The report, as plain JSON; with a store also what of the results is kept there.
    """
    progress("loading", 0, 1)
    from steradian.jobs.registry import JOB_TYPES
    from steradian.jobs.tasks.context import JobContext
    from steradian.reconstructions.pipeline.plan_cache import PlanCache

    if not kept:
        kept.append(PlanCache())
    kind = JOB_TYPES.get(payload["kind"])
    if kind is None:
        raise InvalidInput("kind", payload["kind"], ", ".join(JOB_TYPES))
    folder, start = JobDirectory(Path(payload["job"])), int(payload["start"])

    def go_on(stage: str, done: int, total: int) -> None:
        folder.check_fence(start)
        progress(stage, done, total)

    _log.info("start %d of %s %s", start, payload["kind"], folder.root.name)
    folder.begin_attempt(start)
    with folder.hold_running_lock(), fenced_drafts(str(start), lambda: folder.check_fence(start)):
        data = DataDirectory(Path(payload["data"]))
        with _store() if payload.get("store") else nullcontext(FolderBlobStore(data)) as arrays:
            about = JobContext(data, folder.root, payload["principal"], kept[0], go_on, arrays)
            report = kind.run(about, payload["request"])
            if not payload.get("store"):
                return report
            go_on("storing", 0, 1)
            from steradian.jobs.worker.results import upload_results

            return report | upload_results(arrays, folder)


@contextmanager
def _store() -> Iterator[BlobStore]:
    from steradian.storage.blobs.object_store import arrays_of
    from steradian.storage.db.database import Database, metadata_url

    settings = Settings.create()
    database = Database(metadata_url(settings))
    try:
        yield arrays_of(settings, database)
    finally:
        database.close()


if __name__ == "__main__":
    configure_logging(Settings.create(), "job", waits=True)
    logging.getLogger("numba").setLevel(logging.WARNING)  # else it writes whole programs down
    child_main(partial(run_job, kept=[]))
