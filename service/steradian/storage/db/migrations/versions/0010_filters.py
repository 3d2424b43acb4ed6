"""Add columns and indexes for list filters."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"

JOBS = sa.table("jobs", sa.column("payload", sa.JSON), sa.column("scan_id"))


def upgrade() -> None:
    """Add the column, which duplicates a member of the request, and the indexes."""
    op.add_column("jobs", sa.Column("scan_id", sa.String(40)))
    op.execute(JOBS.update().values(scan_id=JOBS.c.payload["scan_id"].as_string()))
    for table, column in (("jobs", "scan_id"), ("jobs", "batch_id"), ("jobs", "kind"), ("scans", "mask_id")):
        op.create_index(f"ix_{table}_{column}", table, [column])
