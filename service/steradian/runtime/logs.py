"""Logs: one line an entry on standard error, for people or, as JSON, for machines."""

from __future__ import annotations

import contextvars
import json
import logging
from datetime import UTC, datetime

from steradian.settings import Settings

request_id: contextvars.ContextVar[str] = contextvars.ContextVar("request_id", default="")
"""Identifier of the HTTP request that is being served, if any."""
_STANDARD = frozenset(logging.makeLogRecord({}).__dict__) | {"message", "asctime", "request"}


class _Json(logging.Formatter):
    """An entry as one JSON object; what was given as ``extra`` becomes members of it."""

    def __init__(self, process: str) -> None:
        super().__init__()
        self._process = process

    def format(self, record: logging.LogRecord) -> str:
        """Write."""
        entry = {
            "at": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname,
            "process": self._process,
            "logger": record.name,
            "message": record.getMessage(),
            **{name: value for name, value in record.__dict__.items() if name not in _STANDARD},
        }
        if request := request_id.get():
            entry["request_id"] = request
        if record.exc_info:
            entry["exception"] = self.formatException(record.exc_info)
        return json.dumps(entry, default=str)


class _Text(logging.Formatter):
    """An entry as a line to read."""

    def __init__(self, process: str) -> None:
        super().__init__(f"%(asctime)s %(levelname)s {process} %(message)s")

    def format(self, record: logging.LogRecord) -> str:
        """Write."""
        line = super().format(record)
        return f"{line} [request {request}]" if (request := request_id.get()) else line


def configure_logging(settings: Settings, process: str) -> None:
    """Set up this process's log; ``process`` is the name it has in every line."""
    handler = logging.StreamHandler()
    handler.setFormatter(_Json(process) if settings.log_format == "json" else _Text(process))
    logging.basicConfig(level=settings.log_level, handlers=[handler], force=True)
