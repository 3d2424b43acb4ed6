"""Add request_id to scans and jobs."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"


def upgrade() -> None:
    """Add the columns, unknown for existing rows."""
    for table in ("scans", "jobs"):
        op.add_column(table, sa.Column("request_id", sa.String(64)))
