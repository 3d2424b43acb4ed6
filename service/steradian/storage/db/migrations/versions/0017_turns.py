"""Add jobs.owner and jobs.turn for fair queueing."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0017"
down_revision = "0016"


def upgrade() -> None:
    """Add the columns; queued jobs keep their order and precede new jobs of equal priority."""
    op.add_column("jobs", sa.Column("owner", sa.Text(), nullable=False, server_default=""))
    op.add_column("jobs", sa.Column("turn", sa.Integer(), nullable=False, server_default="0"))
