"""Creation of all tables."""

from __future__ import annotations

import secrets

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None


def upgrade() -> None:
    """Create all tables, and the epoch of the event log."""
    _designs()
    _scans()
    _jobs()
    _scanners()
    _events()
    _files()
    _access()


def _sequence() -> sa.Column[int]:
    return sa.Column("sequence", sa.Integer, primary_key=True, autoincrement=True)


def _designs() -> None:
    op.create_table(
        "masks",
        _sequence(),
        sa.Column("id", sa.String(40), nullable=False, unique=True),
        sa.Column("created", sa.String(32), nullable=False),
        sa.Column("aperture", sa.Double, nullable=False),
        sa.Column("depth", sa.Double),
        sa.Column("count", sa.Integer, nullable=False),
        sa.Column("weight_ratio", sa.Double, nullable=False),
        sa.Column("sensed_area", sa.Double, nullable=False),
        sa.Column("arrangement", sa.JSON, nullable=False),
        sa.Column("document", sa.Text, nullable=False),
    )
    op.create_table(
        "plans",
        _sequence(),
        sa.Column("id", sa.String(40), nullable=False, unique=True),
        sa.Column("mask_id", sa.String(40), sa.ForeignKey("masks.id"), nullable=False, index=True),
        sa.Column("created", sa.String(32), nullable=False),
        sa.Column("parameters", sa.JSON, nullable=False),
        sa.Column("preview", sa.JSON, nullable=False),
    )


def _scans() -> None:
    op.create_table(
        "scans",
        _sequence(),
        sa.Column("id", sa.String(40), nullable=False, unique=True),
        sa.Column("revision", sa.Integer, nullable=False),
        sa.Column("plan_id", sa.String(40), sa.ForeignKey("plans.id"), nullable=False, index=True),
        sa.Column("measured_plan_id", sa.String(40), sa.ForeignKey("plans.id"), index=True),
        sa.Column("mask_id", sa.String(40), nullable=False, index=True),
        sa.Column("stages", sa.JSON),
        sa.Column("scanner_id", sa.String(40), index=True),
        sa.Column("completes", sa.String(40)),
        sa.Column("request_id", sa.String(64)),
        sa.Column("simulated", sa.Boolean, nullable=False),
        sa.Column("labels", sa.JSON, nullable=False),
        sa.Column("fence", sa.Integer, nullable=False),
        sa.Column("state", sa.String(32), nullable=False, index=True),
        sa.Column("desired_state", sa.String(32), nullable=False),
        sa.Column("wished_by", sa.String(160)),
        sa.Column("reason", sa.Text),
        sa.Column("created", sa.String(32), nullable=False),
        sa.Column("started", sa.String(32)),
        sa.Column("ended", sa.String(32)),
        sa.Column("stage", sa.String(120)),
        sa.Column("done", sa.Integer, nullable=False),
        sa.Column("total", sa.Integer, nullable=False),
        sa.Column("error_code", sa.String(64)),
        sa.Column("error", sa.Text),
        sa.Column("summary", sa.JSON),
        sa.Column("history", sa.JSON, nullable=False),
    )


def _jobs() -> None:
    op.create_table(
        "jobs",
        _sequence(),
        sa.Column("id", sa.String(40), nullable=False, unique=True),
        sa.Column("revision", sa.Integer, nullable=False),
        sa.Column("kind", sa.String(40), nullable=False, index=True),
        sa.Column("resource", sa.String(16), nullable=False),
        sa.Column("payload", sa.JSON, nullable=False),
        sa.Column("scan_id", sa.String(40), index=True),
        sa.Column("batch_id", sa.String(40), index=True),
        sa.Column("simulated", sa.Boolean, nullable=False),
        sa.Column("request_id", sa.String(64)),
        sa.Column("owner", sa.Text, nullable=False),
        sa.Column("priority", sa.Integer, nullable=False),
        sa.Column("turn", sa.Integer, nullable=False),
        sa.Column("timeout", sa.Double),
        sa.Column("requires_memory", sa.BigInteger, nullable=False),
        sa.Column("requires_cores", sa.Integer, nullable=False),
        sa.Column("requires_gpu", sa.Boolean, nullable=False),
        sa.Column("state", sa.String(32), nullable=False, index=True),
        sa.Column("desired_state", sa.String(32), nullable=False),
        sa.Column("reason", sa.Text),
        sa.Column("created", sa.String(32), nullable=False),
        sa.Column("started", sa.String(32)),
        sa.Column("ended", sa.String(32)),
        sa.Column("fence", sa.Integer, nullable=False),
        sa.Column("attempt", sa.Integer, nullable=False),
        sa.Column("attempts", sa.JSON, nullable=False),
        sa.Column("stage", sa.String(120)),
        sa.Column("done", sa.Integer, nullable=False),
        sa.Column("total", sa.Integer, nullable=False),
        sa.Column("error_code", sa.String(64)),
        sa.Column("error", sa.Text),
        sa.Column("result", sa.JSON),
        sa.Column("history", sa.JSON, nullable=False),
        sa.Column("measurements", sa.JSON),
    )
    op.create_table(
        "batches",
        _sequence(),
        sa.Column("id", sa.String(40), nullable=False, unique=True),
        sa.Column("scan_id", sa.String(40), sa.ForeignKey("scans.id"), nullable=False, index=True),
        sa.Column("created", sa.String(32), nullable=False),
        sa.Column("vary", sa.JSON, nullable=False),
        sa.Column("parameters", sa.JSON, nullable=False),
    )
    op.create_table(
        "workers",
        sa.Column("name", sa.String(140), primary_key=True),
        sa.Column("memory", sa.BigInteger),
        sa.Column("cores", sa.Integer, nullable=False),
        sa.Column("gpu", sa.Text),
        sa.Column("scanner_id", sa.String(40)),
        sa.Column("seen", sa.String(32), nullable=False),
    )


def _scanners() -> None:
    op.create_table(
        "scanners",
        _sequence(),
        sa.Column("id", sa.String(40), nullable=False, unique=True),
        sa.Column("revision", sa.Integer, nullable=False),
        sa.Column("simulated", sa.Boolean, nullable=False),
        sa.Column("connection", sa.String(32), nullable=False),
        sa.Column("state", sa.String(32), nullable=False),
        sa.Column("interlock", sa.String(16), nullable=False),
        sa.Column("key_switch", sa.String(16), nullable=False),
        sa.Column("shutter", sa.String(16), nullable=False),
        sa.Column("laser", sa.String(16), nullable=False),
        sa.Column("fault", sa.JSON),
        sa.Column("port_holder", sa.String(200)),
        sa.Column("model", sa.String(120)),
        sa.Column("serial", sa.String(120)),
        sa.Column("looked_at", sa.String(32)),
        sa.Column("since", sa.String(32), nullable=False),
        sa.Column("last_error", sa.Text),
        sa.Column("fence", sa.Integer, nullable=False),
        sa.Column("holder", sa.String(120)),
        sa.Column("held_by", sa.String(160)),
        sa.Column("note", sa.Text),
        sa.Column("lease_ends", sa.String(32)),
        sa.Column("stopped_at", sa.String(32)),
        sa.Column("stopped_by", sa.String(120)),
        sa.Column("stop_reason", sa.Text),
        sa.Column("stop_number", sa.String(40)),
        sa.Column("stop_laser", sa.String(16)),
        sa.Column("stop_seconds", sa.Double),
        sa.Column("stop_detail", sa.Text),
        sa.Column("address", sa.String(200)),
        sa.Column("follows", sa.Boolean, nullable=False),
        sa.Column("retired", sa.String(32)),
    )


def _events() -> None:
    op.create_table(
        "events",
        _sequence(),
        sa.Column("at", sa.String(32), nullable=False, index=True),
        sa.Column("kind", sa.String(40), nullable=False),
        sa.Column("resource_id", sa.String(40), nullable=False),
        sa.Column("scan_id", sa.String(40)),
        sa.Column("data", sa.JSON, nullable=False),
        sqlite_autoincrement=True,
    )
    facts = op.create_table(
        "event_log",
        sa.Column("name", sa.String(40), primary_key=True),
        sa.Column("value", sa.String(64), nullable=False),
    )
    op.bulk_insert(facts, [{"name": "epoch", "value": secrets.token_hex(4)}])


def _files() -> None:
    op.create_table(
        "removals",
        _sequence(),
        sa.Column("kind", sa.String(40), nullable=False),
        sa.Column("resource_id", sa.String(40), nullable=False),
    )
    op.create_table(
        "objects",
        sa.Column("name", sa.String(200), primary_key=True),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("size", sa.BigInteger, nullable=False),
        sa.Column("created", sa.String(32), nullable=False),
    )


def _access() -> None:
    op.create_table(
        "api_keys",
        _sequence(),
        sa.Column("id", sa.String(40), nullable=False, unique=True),
        sa.Column("name", sa.String(120), nullable=False),
        sa.Column("hash", sa.String(64), nullable=False),
        sa.Column("scopes", sa.JSON, nullable=False),
        sa.Column("created", sa.String(32), nullable=False),
        sa.Column("expires", sa.String(32)),
        sa.Column("revoked", sa.String(32)),
    )
    op.create_table(
        "sessions",
        sa.Column("hash", sa.String(64), primary_key=True),
        sa.Column("issuer", sa.String(64), nullable=False, index=True),
        sa.Column("created", sa.String(32), nullable=False),
        sa.Column("expires", sa.String(32), nullable=False),
    )
    op.create_table(
        "idempotency_keys",
        _sequence(),
        sa.Column("key", sa.String(500), nullable=False, unique=True),
        sa.Column("created", sa.String(32), nullable=False),
        sa.Column("body_hash", sa.String(64), nullable=False),
        sa.Column("status", sa.Integer, nullable=False),
        sa.Column("location", sa.String(200), nullable=False),
        sa.Column("answer", sa.Text, nullable=False),
    )
