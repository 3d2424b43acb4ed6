"""Record when a ticket's event stream was first opened."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"


def upgrade() -> None:
    """Add the column."""
    op.add_column("tickets", sa.Column("opened", sa.String(32)))
