"""Masks, plans, scans, reconstructions and idempotency keys."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None


def upgrade() -> None:
    """Make the first tables."""
    op.create_table(
        "masks",
        sa.Column("sequence", sa.Integer, primary_key=True, autoincrement=True),
        sa.Column("id", sa.String(40), nullable=False, unique=True),
        sa.Column("created", sa.String(32), nullable=False),
        sa.Column("aperture", sa.Double, nullable=False),
        sa.Column("depth", sa.Double),
        sa.Column("count", sa.Integer, nullable=False),
        sa.Column("weight_ratio", sa.Double, nullable=False),
        sa.Column("arrangement", sa.JSON, nullable=False),
        sa.Column("document", sa.Text, nullable=False),
    )
    op.create_table(
        "plans",
        sa.Column("sequence", sa.Integer, primary_key=True, autoincrement=True),
        sa.Column("id", sa.String(40), nullable=False, unique=True),
        sa.Column("mask_id", sa.String(40), sa.ForeignKey("masks.id"), nullable=False, index=True),
        sa.Column("created", sa.String(32), nullable=False),
        sa.Column("parameters", sa.JSON, nullable=False),
        sa.Column("preview", sa.JSON, nullable=False),
    )
    op.create_table(
        "scans",
        sa.Column("sequence", sa.Integer, primary_key=True, autoincrement=True),
        sa.Column("id", sa.String(40), nullable=False, unique=True),
        sa.Column("plan_id", sa.String(40), sa.ForeignKey("plans.id"), nullable=False, index=True),
        sa.Column("mask_id", sa.String(40), nullable=False),
        sa.Column("simulated", sa.Boolean, nullable=False),
        sa.Column("state", sa.String(32), nullable=False, index=True),
        sa.Column("desired_state", sa.String(32), nullable=False),
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
    op.create_table(
        "reconstructions",
        sa.Column("sequence", sa.Integer, primary_key=True, autoincrement=True),
        sa.Column("id", sa.String(40), nullable=False, unique=True),
        sa.Column("scan_id", sa.String(40), sa.ForeignKey("scans.id"), nullable=False, index=True),
        sa.Column("simulated", sa.Boolean, nullable=False),
        sa.Column("created", sa.String(32), nullable=False),
        sa.Column("parameters", sa.JSON, nullable=False),
        sa.Column("cancel_reason", sa.Text),
        sa.Column("cancel_wanted", sa.Boolean, nullable=False),
        sa.Column("submitted", sa.Boolean, nullable=False),
    )
    op.create_table(
        "idempotency_keys",
        sa.Column("sequence", sa.Integer, primary_key=True, autoincrement=True),
        sa.Column("key", sa.String(280), nullable=False, unique=True),
        sa.Column("created", sa.String(32), nullable=False),
        sa.Column("body_hash", sa.String(64), nullable=False),
        sa.Column("resource_id", sa.String(40), nullable=False),
    )
