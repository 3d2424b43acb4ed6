"""Which request a scan or job was asked for by."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"


def upgrade() -> None:
    """Add the columns; of what is there already nobody knows."""
    for table in ("scans", "jobs"):
        op.add_column(table, sa.Column("request_id", sa.String(64)))
