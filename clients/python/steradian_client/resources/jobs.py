"""Collection of jobs: all jobs of the queue, and creation of jobs other than reconstructions."""

from __future__ import annotations

import builtins
from pathlib import Path
from typing import Any

from steradian_client import routes
from steradian_client.downloads import Report, download
from steradian_client.models import Attempt, Job
from steradian_client.resources.base import AwaitableResource
from steradian_client.sync_async import Mode, dual_method


class Jobs(AwaitableResource[Mode, Job]):
    """Collection of all jobs in the queue; creates jobs other than reconstructions."""

    _kind, _read, _list, _delete = Job, routes.READ_JOB, routes.LIST_JOBS, routes.DELETE_JOB
    _event = None  # reconstructions are jobs, too

    @dual_method
    async def create(self, /, kind: str, *, idempotency_key: str | None = None, **asked: Any) -> Job:
        """Queue a job: sound-speed, quality, width, regions, figure, export or import, with its parameters."""
        return await self._session.request_model(
            Job, routes.CREATE_JOB, json={"kind": kind, **asked}, key=idempotency_key
        )

    @dual_method
    async def set_priority(self, job_id: str, priority: int) -> Job:
        """Change the priority of a queued job; smaller values run first."""
        return await self._session.request_model(Job, routes.CHANGE_JOB, {"id": job_id}, json={"priority": priority})

    @dual_method
    async def cancel(self, job_id: str, reason: str | None = None) -> Job:
        """Cancel a queued or running job."""
        body = {"state": "cancelled", "reason": reason}
        return await self._session.request_model(Job, routes.WISH_JOB, {"id": job_id}, json=body)

    @dual_method
    async def attempts(self, job_id: str) -> builtins.list[Attempt]:
        """Return all execution attempts of a job with their outcomes."""
        return await self._session.list(Attempt, routes.READ_JOB_ATTEMPTS, identifiers={"id": job_id})

    @dual_method
    async def log(self, job_id: str) -> str:
        """Return the log of the job."""
        return (await self._session.send_with_retries(routes.READ_JOB_LOG, {"id": job_id})).text

    @dual_method
    async def download_file(
        self, job_id: str, name: str, target: Path | str, *, progress: Report | None = None
    ) -> Path:
        """Download one of the result ``files`` of a job; an interrupted download is resumed."""
        return await download(
            self._session, routes.READ_JOB_FILE, {"id": job_id, "name": name}, target, progress=progress
        )
