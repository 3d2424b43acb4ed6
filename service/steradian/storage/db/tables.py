"""SQLAlchemy tables of the metadata database.

``sequence`` counts rows in the order they were made, for paging. Times are UTC in ISO 8601 text.
"""

from __future__ import annotations

from datetime import datetime
from typing import Any, ClassVar

from sqlalchemy import JSON, BigInteger, Double, ForeignKey, Index, String, Text
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

from steradian.storage.db.types import EnumText, UtcTime
from steradian.storage.state_machines import DesiredJobState, DesiredScanState, ReconstructionState, ScanState


class Base(DeclarativeBase):
    """SQLAlchemy's declarative base class of all tables."""

    type_annotation_map: ClassVar[dict[Any, Any]] = {
        datetime: UtcTime,
        float: Double,
        dict[str, Any]: JSON,
        dict[str, str]: JSON,
        list[dict[str, Any]]: JSON,
        list[str]: JSON,
    }


class MaskRow(Base):
    """Table of masks; ``document`` is the mask as JSON, the other columns repeat values shown in lists."""

    __tablename__ = "masks"
    sequence: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(String(40), unique=True)
    created: Mapped[datetime]
    aperture: Mapped[float]
    depth: Mapped[float | None]
    count: Mapped[int]
    weight_ratio: Mapped[float]
    sensed_area: Mapped[float]
    arrangement: Mapped[dict[str, Any]]
    document: Mapped[str] = mapped_column(Text, deferred=True)


class PlanRow(Base):
    """Table of scan plans: parameters, mask and cost."""

    __tablename__ = "plans"
    sequence: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(String(40), unique=True)
    mask_id: Mapped[str] = mapped_column(ForeignKey("masks.id"), index=True)
    created: Mapped[datetime]
    parameters: Mapped[dict[str, Any]]
    preview: Mapped[dict[str, Any]]


class ScanRow(Base):
    """Table of scans: plan, state and progress.

    ``revision`` is the row version, ``fence`` the number of the scanner lease, ``completes`` the partial scan that this
    scan continues, ``request_id`` the HTTP request that created the row, if any. Imported scans have no ``scanner_id``.
    Of a scan in ``stages`` ``measured_plan_id`` is the plan of those made so far, and ``mask_id`` its mask.
    """

    __tablename__ = "scans"
    sequence: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(String(40), unique=True)
    revision: Mapped[int] = mapped_column()
    plan_id: Mapped[str] = mapped_column(ForeignKey("plans.id"), index=True)
    measured_plan_id: Mapped[str | None] = mapped_column(ForeignKey("plans.id"), index=True)
    mask_id: Mapped[str] = mapped_column(String(40), index=True)
    stages: Mapped[list[dict[str, Any]] | None]
    scanner_id: Mapped[str | None] = mapped_column(String(40), index=True)
    completes: Mapped[str | None] = mapped_column(String(40))
    request_id: Mapped[str | None] = mapped_column(String(64))
    simulated: Mapped[bool]
    labels: Mapped[dict[str, str]]
    fence: Mapped[int]
    state: Mapped[ScanState] = mapped_column(EnumText(ScanState), index=True)
    desired_state: Mapped[DesiredScanState] = mapped_column(EnumText(DesiredScanState))
    wished_by: Mapped[str | None] = mapped_column(String(160))
    reason: Mapped[str | None] = mapped_column(Text)
    created: Mapped[datetime]
    started: Mapped[datetime | None]
    ended: Mapped[datetime | None]
    stage: Mapped[str | None] = mapped_column(String(120))
    done: Mapped[int] = mapped_column(default=0)
    total: Mapped[int] = mapped_column(default=0)
    error_code: Mapped[str | None] = mapped_column(String(64))
    error: Mapped[str | None] = mapped_column(Text)
    summary: Mapped[dict[str, Any] | None]
    history: Mapped[list[dict[str, Any]]]
    __mapper_args__ = {"version_id_col": revision}  # noqa: RUF012 - so the base class has it


class JobRow(Base):
    """Table of jobs: state, attempts, progress and history.

    The queue engine decides which worker runs a job and when; all other code reads this row. ``fence`` is the fencing
    token: the number of attempts, including requeued ones; reports of earlier attempts are rejected. ``scan_id``
    repeats the payload's, for lists; ``resource`` is the job's API resource, *reconstruction* or *job*; ``simulated``
    says whether its scan is simulated; ``request_id`` is the HTTP request that created the job, ``owner`` its principal
    and ``turn`` its fair-queueing start tag. ``requires_…`` are requirements on the worker, ``measurements`` the
    measurements in its volume.
    """

    __tablename__ = "jobs"
    sequence: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(String(40), unique=True)
    revision: Mapped[int] = mapped_column()
    kind: Mapped[str] = mapped_column(String(40), index=True)
    resource: Mapped[str] = mapped_column(String(16))
    payload: Mapped[dict[str, Any]]
    scan_id: Mapped[str | None] = mapped_column(String(40), index=True)
    batch_id: Mapped[str | None] = mapped_column(String(40), index=True)
    simulated: Mapped[bool] = mapped_column(default=False)
    request_id: Mapped[str | None] = mapped_column(String(64))
    owner: Mapped[str] = mapped_column(Text, default="")
    priority: Mapped[int]
    turn: Mapped[int] = mapped_column(default=0)
    timeout: Mapped[float | None]
    requires_memory: Mapped[int] = mapped_column(BigInteger, default=0)
    requires_cores: Mapped[int] = mapped_column(default=0)
    requires_gpu: Mapped[bool] = mapped_column(default=False)
    state: Mapped[ReconstructionState] = mapped_column(EnumText(ReconstructionState), index=True)
    desired_state: Mapped[DesiredJobState] = mapped_column(EnumText(DesiredJobState))
    reason: Mapped[str | None] = mapped_column(Text)
    created: Mapped[datetime]
    started: Mapped[datetime | None]
    ended: Mapped[datetime | None]
    fence: Mapped[int] = mapped_column(default=0)
    attempt: Mapped[int] = mapped_column(default=0)
    attempts: Mapped[list[dict[str, Any]]]
    stage: Mapped[str | None] = mapped_column(String(120))
    done: Mapped[int] = mapped_column(default=0)
    total: Mapped[int] = mapped_column(default=0)
    error_code: Mapped[str | None] = mapped_column(String(64))
    error: Mapped[str | None] = mapped_column(Text)
    result: Mapped[dict[str, Any] | None]
    history: Mapped[list[dict[str, Any]]]
    measurements: Mapped[dict[str, Any] | None] = mapped_column(deferred=True)
    __mapper_args__ = {"version_id_col": revision}  # noqa: RUF012 - so the base class has it


class BatchRow(Base):
    """Table of batches of reconstructions that were requested together."""

    __tablename__ = "batches"
    sequence: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(String(40), unique=True)
    scan_id: Mapped[str] = mapped_column(ForeignKey("scans.id"), index=True)
    created: Mapped[datetime]
    vary: Mapped[dict[str, Any]]
    parameters: Mapped[dict[str, Any]]


class ScannerRow(Base):
    """Table of scanners: reported state, lease and emergency stop.

    ``held_by`` is the principal with the lease, ``holder`` the name that the client has given. ``address`` is the URL
    of the scanner's node for other nodes, ``follows`` whether that node has workers for live jobs. ``looked_at`` is the
    time of the scanner's report of ``laser``, ``shutter``, ``interlock``, ``key_switch`` and ``fault``; ``port_holder``
    is another program that has opened the port. ``stop_number``, ``stop_laser``, ``stop_seconds`` and ``stop_detail``
    describe the active emergency stop. ``retired`` is the time of the decommission, empty after the next start of the
    node; an active stop stays active.
    """

    __tablename__ = "scanners"
    sequence: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(String(40), unique=True)
    revision: Mapped[int] = mapped_column()
    simulated: Mapped[bool]
    connection: Mapped[str] = mapped_column(String(32))
    state: Mapped[str] = mapped_column(String(32))
    interlock: Mapped[str] = mapped_column(String(16), default="unknown")
    key_switch: Mapped[str] = mapped_column(String(16), default="unknown")
    shutter: Mapped[str] = mapped_column(String(16), default="unknown")
    laser: Mapped[str] = mapped_column(String(16), default="unknown")
    fault: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True))
    port_holder: Mapped[str | None] = mapped_column(String(200))
    model: Mapped[str | None] = mapped_column(String(120))
    serial: Mapped[str | None] = mapped_column(String(120))
    looked_at: Mapped[datetime | None]
    since: Mapped[datetime]
    last_error: Mapped[str | None] = mapped_column(Text)
    fence: Mapped[int]
    holder: Mapped[str | None] = mapped_column(String(120))
    held_by: Mapped[str | None] = mapped_column(String(160))
    note: Mapped[str | None] = mapped_column(Text)
    lease_ends: Mapped[datetime | None]
    stopped_at: Mapped[datetime | None]
    stopped_by: Mapped[str | None] = mapped_column(String(120))
    stop_reason: Mapped[str | None] = mapped_column(Text)
    stop_number: Mapped[str | None] = mapped_column(String(40))
    stop_laser: Mapped[str | None] = mapped_column(String(16))
    stop_seconds: Mapped[float | None]
    stop_detail: Mapped[str | None] = mapped_column(Text)
    address: Mapped[str | None] = mapped_column(String(200))
    follows: Mapped[bool] = mapped_column(default=False)
    retired: Mapped[datetime | None]
    __mapper_args__ = {"version_id_col": revision}  # noqa: RUF012 - so the base class has it


class WorkerRow(Base):
    """Table of workers: reported capabilities and time of the last report.

    ``scanner_id`` is the scanner whose live jobs are the only ones that the worker runs; empty: all jobs.
    """

    __tablename__ = "workers"
    name: Mapped[str] = mapped_column(String(140), primary_key=True)
    memory: Mapped[int | None] = mapped_column(BigInteger)
    cores: Mapped[int]
    gpu: Mapped[str | None] = mapped_column(Text)
    scanner_id: Mapped[str | None] = mapped_column(String(40))
    seen: Mapped[datetime]


class RemovalRow(Base):
    """Table of deleted resources with files that are not yet removed."""

    __tablename__ = "removals"
    sequence: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    kind: Mapped[str] = mapped_column(String(40))
    resource_id: Mapped[str] = mapped_column(String(40))


class ObjectRow(Base):
    """Table of objects in the object store; name and ``sha256`` of the content are an object's key."""

    __tablename__ = "objects"
    name: Mapped[str] = mapped_column(String(200), primary_key=True)
    sha256: Mapped[str] = mapped_column(String(64))
    size: Mapped[int] = mapped_column(BigInteger)
    created: Mapped[datetime]


class EventRow(Base):
    """Table of the event log: every change of state, in order."""

    __tablename__ = "events"
    sequence: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    at: Mapped[datetime]
    kind: Mapped[str] = mapped_column(String(40))
    resource_id: Mapped[str] = mapped_column(String(40))
    scan_id: Mapped[str | None] = mapped_column(String(40))
    data: Mapped[dict[str, Any]]
    __table_args__ = (Index("ix_events_at", "at"), {"sqlite_autoincrement": True})


class FactRow(Base):
    """Table of key-value facts about the database as a whole.

    Keys: the event log's epoch (of this database), the identifiers of the bound data folder and object store, and the
    version of the queue engine that migrated its tables.
    """

    __tablename__ = "event_log"
    name: Mapped[str] = mapped_column(String(40), primary_key=True)
    value: Mapped[str] = mapped_column(String(64))


class ApiKeyRow(Base):
    """Table of API keys, with the hashes of their secrets."""

    __tablename__ = "api_keys"
    sequence: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(String(40), unique=True)
    name: Mapped[str] = mapped_column(String(120))
    hash: Mapped[str] = mapped_column(String(64))
    scopes: Mapped[list[str]]
    created: Mapped[datetime]
    expires: Mapped[datetime | None]
    revoked: Mapped[datetime | None]


class SessionRow(Base):
    """Table of browser sessions, by the hashes of their secrets."""

    __tablename__ = "sessions"
    hash: Mapped[str] = mapped_column(String(64), primary_key=True)
    issuer: Mapped[str] = mapped_column(String(64), index=True)
    """Identifier of the key, or hash of the settings' one."""
    created: Mapped[datetime]
    expires: Mapped[datetime]


class IdempotencyRow(Base):
    """Table of responses to requests with an idempotency key."""

    __tablename__ = "idempotency_keys"
    sequence: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    key: Mapped[str] = mapped_column(String(500), unique=True)
    created: Mapped[datetime]
    body_hash: Mapped[str] = mapped_column(String(64))
    status: Mapped[int]
    location: Mapped[str] = mapped_column(String(200))
    answer: Mapped[str] = mapped_column(Text)
