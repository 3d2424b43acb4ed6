"""Lists are filtered by what has an index: a job's scan, batch and kind, a scan's mask."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"

JOBS = sa.table("jobs", sa.column("payload", sa.JSON), sa.column("scan_id"))


def upgrade() -> None:
    """Add the column, which repeats a member of what was asked, and the indexes."""
    op.add_column("jobs", sa.Column("scan_id", sa.String(40)))
    op.execute(JOBS.update().values(scan_id=JOBS.c.payload["scan_id"].as_string()))
    for table, column in (("jobs", "scan_id"), ("jobs", "batch_id"), ("jobs", "kind"), ("scans", "mask_id")):
        op.create_index(f"ix_{table}_{column}", table, [column])
