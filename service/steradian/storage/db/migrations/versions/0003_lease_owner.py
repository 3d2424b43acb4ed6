"""Add scanners.held_by; end leases without an owner."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"


def upgrade() -> None:
    """Add the column."""
    op.add_column("scanners", sa.Column("held_by", sa.String(160)))
    op.execute("UPDATE scanners SET holder = NULL, note = NULL, lease_ends = NULL")
