"""Add scanners.retired."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0016"
down_revision = "0015"


def upgrade() -> None:
    """Add the column."""
    op.add_column("scanners", sa.Column("retired", sa.String(32)))
