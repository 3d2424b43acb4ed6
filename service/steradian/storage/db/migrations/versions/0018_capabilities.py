"""Create the worker table; add job requirements."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0018"
down_revision = "0017"


def upgrade() -> None:
    """Add the table and the columns; queued jobs have no requirements."""
    op.create_table(
        "workers",
        sa.Column("name", sa.String(140), primary_key=True),
        sa.Column("memory", sa.BigInteger(), nullable=True),
        sa.Column("cores", sa.Integer(), nullable=False),
        sa.Column("gpu", sa.Text(), nullable=True),
        sa.Column("scanner_id", sa.String(40), nullable=True),
        sa.Column("seen", sa.String(32), nullable=False),
    )
    for name, kind, default in (
        ("requires_memory", sa.BigInteger(), "0"),
        ("requires_cores", sa.Integer(), "0"),
        ("requires_gpu", sa.Boolean(), sa.false()),
    ):
        op.add_column("jobs", sa.Column(name, kind, nullable=False, server_default=default))
