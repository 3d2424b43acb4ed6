"""Drop jobs.submitted: queue and metadata now share one database."""

from __future__ import annotations

from alembic import op

revision = "0008"
down_revision = "0007"


def upgrade() -> None:
    """Remove the column; jobs that wait in an earlier queue's file are queued again from their rows."""
    with op.batch_alter_table("jobs") as table:
        table.drop_column("submitted")
