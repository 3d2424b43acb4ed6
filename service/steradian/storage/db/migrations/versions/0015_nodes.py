"""Add scans.scanner_id, node addresses, stop outcome and open stream counts."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0015"
down_revision = "0014"


def upgrade() -> None:
    """Add the columns; scans that are over need no scanner any more."""
    op.add_column("scans", sa.Column("scanner_id", sa.String(40)))
    op.create_index("ix_scans_scanner_id", "scans", ["scanner_id"])
    op.execute("UPDATE scans SET scanner_id = 'scanner-0' WHERE ended IS NULL")
    op.add_column("scanners", sa.Column("stop_number", sa.String(40)))
    op.add_column("scanners", sa.Column("stop_laser", sa.String(16)))
    op.add_column("scanners", sa.Column("stop_seconds", sa.Double))
    op.add_column("scanners", sa.Column("address", sa.String(200)))
    op.add_column("scanners", sa.Column("follows", sa.Boolean, nullable=False, server_default=sa.false()))
    op.add_column("tickets", sa.Column("streams", sa.Integer, nullable=False, server_default="0"))
