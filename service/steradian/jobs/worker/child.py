"""Subprocess of a worker that runs jobs one after another."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from steradian.core.atomic_files import signed
from steradian.core.exceptions import InvalidInput
from steradian.core.logging_config import configure_logging
from steradian.core.progress import Progress
from steradian.core.settings import Settings
from steradian.jobs.worker.process import child_main
from steradian.storage.blobs.interface import Arrays, Folder
from steradian.storage.data_dir.job_directory import JobDirectory
from steradian.storage.data_dir.layout import DataDirectory

if TYPE_CHECKING:
    from steradian.reconstructions.pipeline.plan_cache import KeptPlans

_log = logging.getLogger("steradian.jobs.worker.child")  # whatever this module is called when it is run


def work(payload: dict[str, Any], progress: Progress, *, kept: list[KeptPlans]) -> dict[str, Any]:
    """Run the task of the payload's kind.

    Parameters
    ----------
    payload
        ``kind`` of the job (:data:`steradian.jobs.registry.KINDS`) and its ``request``, as the ledger has them, the
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
    from steradian.jobs.registry import KINDS
    from steradian.jobs.tasks.context import Work
    from steradian.reconstructions.pipeline.plan_cache import KeptPlans

    if not kept:
        kept.append(KeptPlans())
    kind = KINDS.get(payload["kind"])
    if kind is None:
        raise InvalidInput("kind", payload["kind"], ", ".join(KINDS))
    folder, start = JobDirectory(Path(payload["job"])), int(payload["start"])

    def go_on(stage: str, done: int, total: int) -> None:
        folder.check(start)
        progress(stage, done, total)

    _log.info("start %d of %s %s", start, payload["kind"], folder.root.name)
    folder.begin(start)
    with folder.running(), signed(str(start), lambda: folder.check(start)):
        data = DataDirectory(Path(payload["data"]))
        with _store() if payload.get("store") else nullcontext(Folder(data)) as arrays:
            about = Work(data, folder.root, payload["principal"], kept[0], go_on, arrays)
            report = kind.run(about, payload["request"])
            if not payload.get("store"):
                return report
            go_on("storing", 0, 1)
            from steradian.jobs.worker.results import put_results

            return report | put_results(arrays, folder)


@contextmanager
def _store() -> Iterator[Arrays]:
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
    child_main(partial(work, kept=[]))
