"""Alembic's environment script: runs the migrations on the connection of :meth:`Database.migrate`."""

from __future__ import annotations

from alembic import context

from steradian.storage.db.tables import Base

context.configure(
    connection=context.config.attributes["connection"], target_metadata=Base.metadata, render_as_batch=True
)
with context.begin_transaction():
    context.run_migrations()
