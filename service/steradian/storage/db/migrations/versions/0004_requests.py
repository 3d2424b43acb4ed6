"""Add jobs.batch_id; rewrite job payloads to the request format."""

from __future__ import annotations

from pathlib import PurePath
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"

JOBS = sa.table("jobs", sa.column("id"), sa.column("kind"), sa.column("payload", sa.JSON), sa.column("batch_id"))


def upgrade() -> None:
    """Add the column and convert stored requests to the current format."""
    op.add_column("jobs", sa.Column("batch_id", sa.String(40)))
    connection = op.get_bind()
    for row in connection.execute(sa.select(JOBS)).all():
        values = {"payload": as_request(row.kind, row.payload), "batch_id": row.payload.get("batch_id")}
        connection.execute(JOBS.update().where(JOBS.c.id == row.id).values(values))


def as_request(kind: str, payload: dict[str, Any]) -> dict[str, Any]:
    """Return a request without batch and paths, with the import parameters that were resolved when it was queued."""
    request = {name: value for name, value in payload.items() if name not in {"batch_id", "scan", "output"}}
    match kind:
        case "reconstruction":
            return {"scan_id": PurePath(payload.get("scan", "")).stem} | request
        case "live":
            return request | {"follow": True}
        case "what-if":
            through = {name: request.pop(name) for name in ("mask_id", "points") if name in request}
            return request | {"through": through}
        case "import":
            return {name: value for name, value in request.items() if name not in {"scan_id", "principal"}}
    return request
