"""The tables of the metadata database.

``sequence`` counts rows in the order they were made: lists page by it, whatever their identifiers look like.
Times are UTC in ISO 8601 text, the same on SQLite and PostgreSQL.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from sqlalchemy import JSON, Double, ForeignKey, String, Text
from sqlalchemy.engine import Dialect
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column
from sqlalchemy.types import TypeDecorator

from steradian.storage.states import DesiredScanState, ScanState


class UtcTime(TypeDecorator[datetime]):
    """An aware UTC time as sortable ISO 8601 text."""

    impl = String(32)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> str | None:
        """Write."""
        return None if value is None else value.astimezone(UTC).isoformat(timespec="microseconds")

    def process_result_value(self, value: str | None, dialect: Dialect) -> datetime | None:
        """Read."""
        return None if value is None else datetime.fromisoformat(value)


class Name(TypeDecorator[str]):
    """A member of a string enum, by its value."""

    impl = String(32)
    cache_ok = True

    def __init__(self, kind: type[ScanState | DesiredScanState]) -> None:
        super().__init__()
        self.kind = kind

    def process_bind_param(self, value: str | None, dialect: Dialect) -> str | None:
        """Write."""
        return None if value is None else str(value)

    def process_result_value(self, value: str | None, dialect: Dialect) -> str | None:
        """Read."""
        return None if value is None else self.kind(value)


class Table(DeclarativeBase):
    """Root of all tables."""

    type_annotation_map = {datetime: UtcTime, float: Double, dict[str, Any]: JSON, list[dict[str, Any]]: JSON}  # noqa: RUF012


class MaskRow(Table):
    """A mask; ``document`` is the whole value as JSON, the other columns repeat what lists show."""

    __tablename__ = "masks"
    sequence: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(String(40), unique=True)
    created: Mapped[datetime]
    aperture: Mapped[float]
    depth: Mapped[float | None]
    count: Mapped[int]
    weight_ratio: Mapped[float]
    arrangement: Mapped[dict[str, Any]]
    document: Mapped[str] = mapped_column(Text, deferred=True)


class PlanRow(Table):
    """A plan: parameters beside the mask they belong to, and what the plan costs."""

    __tablename__ = "plans"
    sequence: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(String(40), unique=True)
    mask_id: Mapped[str] = mapped_column(ForeignKey("masks.id"), index=True)
    created: Mapped[datetime]
    parameters: Mapped[dict[str, Any]]
    preview: Mapped[dict[str, Any]]


class ScanRow(Table):
    """A run of a plan, its state and its progress."""

    __tablename__ = "scans"
    sequence: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(String(40), unique=True)
    plan_id: Mapped[str] = mapped_column(ForeignKey("plans.id"), index=True)
    mask_id: Mapped[str] = mapped_column(String(40))
    simulated: Mapped[bool]
    state: Mapped[ScanState] = mapped_column(Name(ScanState), index=True)
    desired_state: Mapped[DesiredScanState] = mapped_column(Name(DesiredScanState))
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


class ReconstructionRow(Table):
    """What was asked of the queue; how far it came is the queue's to say."""

    __tablename__ = "reconstructions"
    sequence: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(String(40), unique=True)
    scan_id: Mapped[str] = mapped_column(ForeignKey("scans.id"), index=True)
    simulated: Mapped[bool]
    created: Mapped[datetime]
    parameters: Mapped[dict[str, Any]]
    cancel_reason: Mapped[str | None] = mapped_column(Text)
    cancel_wanted: Mapped[bool] = mapped_column(default=False)
    submitted: Mapped[bool] = mapped_column(default=False)


class IdempotencyRow(Table):
    """The answer that a key got, so that a repeated request gets the same one."""

    __tablename__ = "idempotency_keys"
    sequence: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    key: Mapped[str] = mapped_column(String(280), unique=True)
    created: Mapped[datetime]
    body_hash: Mapped[str] = mapped_column(String(64))
    resource_id: Mapped[str] = mapped_column(String(40))
