"""Add jobs.promised (reserved bytes)."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"


def upgrade() -> None:
    """Add the column; of jobs that wait already it is not known how much they will write."""
    op.add_column("jobs", sa.Column("promised", sa.BigInteger, nullable=False, server_default="0"))
