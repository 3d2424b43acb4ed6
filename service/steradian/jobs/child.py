"""Jobs, one after another, in a process of a worker: ``python -m steradian.jobs.child``."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from steradian.drafts import signed
from steradian.errors import InvalidInput
from steradian.jobs.process import child_main
from steradian.progress import Progress
from steradian.storage.paths import DataDirectory, JobDirectory

if TYPE_CHECKING:
    from steradian.reconstructions.kept_plans import KeptPlans


def work(payload: dict[str, Any], progress: Progress, *, kept: list[KeptPlans]) -> dict[str, Any]:
    """Do what the payload asks.

    Parameters
    ----------
    payload
        ``kind`` of the job (:data:`steradian.jobs.kinds.KINDS`) and its ``request``, as the ledger has them, the
        ``principal`` who asked, ``data`` (the data directory), ``job`` (the job's own folder) and ``start`` (the number
        of this start).
    kept
        Where the plans of earlier jobs are; empty before the first one.

    Returns
    -------
    dict
        The report, as plain JSON.
    """
    progress("loading", 0, 1)
    from steradian.jobs.kinds import KINDS
    from steradian.jobs.tasks import Work
    from steradian.reconstructions.kept_plans import KeptPlans

    if not kept:
        kept.append(KeptPlans())
    kind = KINDS.get(payload["kind"])
    if kind is None:
        raise InvalidInput("kind", payload["kind"], ", ".join(KINDS))
    folder, start = JobDirectory(Path(payload["job"])), int(payload["start"])

    def go_on(stage: str, done: int, total: int) -> None:
        folder.check(start)
        progress(stage, done, total)

    folder.begin(start)
    with folder.running(), signed(str(start), lambda: folder.check(start)):
        about = Work(DataDirectory(Path(payload["data"])), folder.root, payload["principal"], kept[0], go_on)
        return kind.run(about, payload["request"])


if __name__ == "__main__":
    child_main(partial(work, kept=[]))
