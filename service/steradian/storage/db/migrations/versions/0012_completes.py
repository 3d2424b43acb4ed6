"""Add scans.completes and the scanners' interlock columns."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"


def upgrade() -> None:
    """Add the columns, empty for existing rows."""
    op.add_column("scans", sa.Column("completes", sa.String(40)))
    for name in ("interlock", "key_switch", "shutter"):
        op.add_column("scanners", sa.Column(name, sa.String(16), nullable=False, server_default="unknown"))
