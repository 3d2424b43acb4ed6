"""Add jobs.fence (fencing token per attempt)."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"


def upgrade() -> None:
    """Add the column; earlier attempts get their attempt numbers."""
    op.add_column("jobs", sa.Column("fence", sa.Integer, nullable=False, server_default="0"))
    op.execute("UPDATE jobs SET fence = attempt")
