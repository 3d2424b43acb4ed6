"""Submission of jobs: admission checks, disk space, references and rows, in one idempotent transaction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from sqlalchemy.orm import Session

from steradian.api.schemas.batches import BatchRequest, BatchView
from steradian.api.schemas.jobs import JobView, ReconstructionView
from steradian.api.services import ServiceContainer
from steradian.api.use_cases.admission import (
    ResourceEstimate,
    check_job,
    check_reconstruction,
    check_references,
    estimate_resources,
    frames_of,
)
from steradian.jobs.queue.job_ledger import to_status
from steradian.jobs.reconstruction_request import ReconstructionRequest
from steradian.jobs.request_base import JobRequestBase
from steradian.jobs.requests import WorkRequest, to_job_request
from steradian.security.keys import Principal
from steradian.storage.db.tables import BatchRow, JobRow, ScanRow
from steradian.storage.db.timestamps_and_ids import new_id
from steradian.storage.repositories.idempotency import IdempotencyKey, StoredResponse
from steradian.storage.repositories.references import lock_references


class Admitted(NamedTuple):
    """Admitted submission: requests, disk space, and the function that inserts the rows.

    Attributes
    ----------
    requests
        Job requests whose references are locked.
    disk
        Bytes that the jobs will write.
    subject
        Noun for the error of a full disk.
    insert
        Function that inserts the rows and returns the response.
    """

    requests: Sequence[JobRequestBase]
    disk: int
    subject: str
    insert: Callable[[Session], StoredResponse]


def submit_reconstruction(
    services: ServiceContainer, principal: Principal, request: ReconstructionRequest, key: IdempotencyKey | None
) -> StoredResponse:
    """Queue a reconstruction and return the response for this and for repeated requests.

    Raises
    ------
    NotFound, NotReady, Conflict, InvalidInput
        As :func:`steradian.api.use_cases.admission.check_reconstruction`.
    DiskFull
        When the volume does not fit on the disk.
    """

    def admit() -> Admitted:
        scan = check_reconstruction(services, request)
        estimate = estimate_resources(services, scan, request)

        def insert(session: Session) -> StoredResponse:
            view = ReconstructionView.of(to_status(_insert(services, session, scan, request, principal, estimate)))
            return StoredResponse(202, view.links["self"], view.model_dump_json())

        return Admitted([request], estimate.disk, "the volume", insert)

    return _submit_once(services, key, admit)


def submit_batch(
    services: ServiceContainer, principal: Principal, request: BatchRequest, key: IdempotencyKey | None
) -> StoredResponse:
    """Queue a reconstruction for each combination of values, all or none; raises as :func:`submit_reconstruction`."""

    def admit() -> Admitted:
        plan_id = services.scans.get(request.scan_id).plan_id
        vary = request.expand_grid(frames_of(services.plans.get(plan_id).parameters))
        members = request.to_job_requests(vary)
        scan = check_reconstruction(services, members[0])
        for member in members[1:]:
            check_references(services, scan, member)
        estimates = [estimate_resources(services, scan, member) for member in members]

        def insert(session: Session) -> StoredResponse:
            batch = services.batches.add(session, scan, vary, request.parameters, principal.name)
            jobs = [
                _insert(services, session, scan, member, principal, estimate, batch)
                for member, estimate in zip(members, estimates, strict=True)
            ]
            view = BatchView.of(batch, [to_status(job) for job in jobs])
            return StoredResponse(202, view.links["self"], view.model_dump_json())

        disk = sum(estimate.disk for estimate in estimates)
        return Admitted(members, disk, f"the batch of {len(members)} volumes", insert)

    return _submit_once(services, key, admit)


def submit_job(
    services: ServiceContainer, principal: Principal, request: WorkRequest, key: IdempotencyKey | None
) -> StoredResponse:
    """Queue a job that is not a reconstruction and return the response for this and for repeated requests.

    Raises the errors of :func:`steradian.api.use_cases.admission.check_job`, and DiskFull.
    """

    def admit() -> Admitted:
        estimate = check_job(services, request)

        def insert(session: Session) -> StoredResponse:
            job = to_job_request(new_id("j"), request, principal=principal.name, memory=estimate.memory)
            row = services.submit(session, job)
            session.flush()
            view = JobView.of(to_status(row))
            return StoredResponse(202, view.links["self"], view.model_dump_json())

        return Admitted([request], estimate.disk, f"the {request.kind}", insert)

    return _submit_once(services, key, admit)


def _submit_once(
    services: ServiceContainer, key: IdempotencyKey | None, admit: Callable[[], Admitted]
) -> StoredResponse:
    """Return the stored response of a repeated request; otherwise check request and disk and insert rows."""
    if (stored := services.idempotency.get(key)) is not None:
        return stored
    admitted = admit()
    services.require_disk_space(admitted.disk, admitted.subject)

    def run(session: Session) -> StoredResponse:
        lock_references(session, *(request.model_dump(mode="json") for request in admitted.requests))
        return admitted.insert(session)

    return services.idempotency.run_once(key, run)


def _insert(
    services: ServiceContainer,
    session: Session,
    scan: ScanRow,
    request: ReconstructionRequest,
    principal: Principal,
    estimate: ResourceEstimate,
    batch: BatchRow | None = None,
) -> JobRow:
    job = to_job_request(
        new_id("r"),
        request,
        principal=principal.name,
        batch_id=None if batch is None else batch.id,
        simulated=scan.simulated,
        memory=estimate.memory,
    )
    row = services.submit(session, job)
    session.flush()
    return row
