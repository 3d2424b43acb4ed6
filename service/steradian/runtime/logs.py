"""Logs: one line an entry on standard error, for people or, as JSON, for machines."""

from __future__ import annotations

import contextvars
import json
import logging
from datetime import UTC, datetime

from steradian.settings import Settings

request_id: contextvars.ContextVar[str] = contextvars.ContextVar("request_id", default="")
"""Identifier of the HTTP request that is being served, if any."""
BURST, WINDOW = 50, 10.0
"""Lines of one kind that are written within so many seconds."""
KINDS = 1000
"""Kinds that are told apart at a time."""
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


class _Limit(logging.Filter):
    """Lets :data:`BURST` lines of one kind through in :data:`WINDOW` seconds; the next says how many were left out."""

    def __init__(self) -> None:
        super().__init__()
        self._seen: dict[tuple[str, int, str], tuple[float, int]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Decide about a line; its kind is the text before anything is put into it."""
        kind, now = (record.name, record.levelno, str(record.msg)[:200]), record.created
        begun, count = self._seen.get(kind, (now, 0))
        if now - begun >= WINDOW:
            left_out, begun, count = count - BURST, now, 0
            if left_out > 0:
                record.msg, record.args = f"{record.getMessage()} [{left_out} such lines were left out before]", None
        if len(self._seen) > KINDS:
            self._seen.clear()
        self._seen[kind] = begun, count + 1
        return count < BURST


def configure_logging(settings: Settings, process: str) -> None:
    """Set up this process's log; ``process`` is the name it has in every line."""
    handler = logging.StreamHandler()
    if settings.log_level != "DEBUG":
        handler.addFilter(_Limit())
    handler.setFormatter(_Json(process) if settings.log_format == "json" else _Text(process))
    logging.basicConfig(level=settings.log_level, handlers=[handler], force=True)
