"""A scan may complete an earlier one; what the scanner last said of interlock, key and shutter."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"


def upgrade() -> None:
    """Add the columns; nothing is known of what was before."""
    op.add_column("scans", sa.Column("completes", sa.String(40)))
    for name in ("interlock", "key_switch", "shutter"):
        op.add_column("scanners", sa.Column(name, sa.String(16), nullable=False, server_default="unknown"))
