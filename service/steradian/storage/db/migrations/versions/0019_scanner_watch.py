"""Laser state and fault reported by a scanner, with their time, and its report after a stop."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0019"
down_revision = "0018"


def upgrade() -> None:
    """Add the columns."""
    op.add_column("scanners", sa.Column("laser", sa.String(16), nullable=False, server_default="unknown"))
    op.add_column("scanners", sa.Column("fault", sa.JSON(), nullable=True))
    op.add_column("scanners", sa.Column("port_holder", sa.String(200), nullable=True))
    op.add_column("scanners", sa.Column("model", sa.String(120), nullable=True))
    op.add_column("scanners", sa.Column("serial", sa.String(120), nullable=True))
    op.add_column("scanners", sa.Column("looked_at", sa.String(32), nullable=True))
    op.add_column("scanners", sa.Column("stop_detail", sa.Text(), nullable=True))
