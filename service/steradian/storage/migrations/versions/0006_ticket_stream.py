"""When a ticket's stream was first opened: who was in it may come back to it."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"


def upgrade() -> None:
    """Add the column."""
    op.add_column("tickets", sa.Column("opened", sa.String(32)))
