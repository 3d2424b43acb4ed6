"""Logging configuration: text or JSON, asynchronous, rate-limited."""

from __future__ import annotations

import contextvars
import json
import logging
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from queue import SimpleQueue
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from steradian.core.settings import Settings

request_id: contextvars.ContextVar[str] = contextvars.ContextVar("request_id", default="")
"""Identifier of the HTTP request that is being served, or that asked for the work being done; empty: none."""
MAX_BURST, WINDOW = 50, 10.0
"""Lines of one kind that are written within so many seconds."""
KINDS = 1000
"""Kinds that are told apart at a time."""
MAX_QUEUED = 1000
"""Lines that wait for who reads the log; more are lost, and their number is told."""
FLUSH = 1.0
"""Seconds that a process that ends waits for them."""
_STANDARD = frozenset(logging.makeLogRecord({}).__dict__) | {"message", "asctime", "request"}


@contextmanager
def bind_request_id(identifier: str | None) -> Iterator[None]:
    """Add a request identifier to all log records until the block ends."""
    token = request_id.set(identifier or "")
    try:
        yield
    finally:
        request_id.reset(token)


def request_id_suffix() -> str:
    """Return the suffix of text log lines that contains the request identifier; empty without a request."""
    return f" [request {request}]" if (request := request_id.get()) else ""


class _Json(logging.Formatter):
    """Formatter of log records as JSON objects; ``extra`` fields become members."""

    def __init__(self, process: str) -> None:
        super().__init__()
        self._process = process

    def format(self, record: logging.LogRecord) -> str:
        """Format a log record as one line of JSON."""
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
    """Formatter of log records as lines of text."""

    def __init__(self, process: str) -> None:
        super().__init__(f"%(asctime)s %(levelname)s {process} %(message)s")

    def formatTime(self, record: logging.LogRecord, datefmt: str | None = None) -> str:  # noqa: N802 - as above
        """Return a record's local time in ISO 8601 with its offset from UTC."""
        return datetime.fromtimestamp(record.created).astimezone().isoformat(timespec="milliseconds")

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - what a traceback follows
        """Format a log record as one line of text, with unprintable characters escaped."""
        line = super().formatMessage(record)
        if not line.isprintable():  # others' words are to begin no line and to steer no terminal
            line = "".join(each if each.isprintable() else ascii(each)[1:-1] for each in line)
        return line + request_id_suffix()


class _RateLimitFilter(logging.Filter):
    """Rate limit of similar log lines: :data:`MAX_BURST` in :data:`WINDOW` seconds, then the omitted number."""

    def __init__(self) -> None:
        super().__init__()
        self._seen: dict[tuple[str, int, str], tuple[float, int]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether to log a record; records with the same message template share a limit."""
        kind, now = (record.name, record.levelno, str(record.msg)[:200]), record.created
        begun, count = self._seen.get(kind, (now, 0))
        if now - begun >= WINDOW:
            left_out, begun, count = count - MAX_BURST, now, 0
            if left_out > 0:
                record.msg, record.args = f"{record.getMessage()} [{left_out} similar lines were omitted before]", None
        if len(self._seen) > KINDS:
            self._seen.clear()
        self._seen[kind] = begun, count + 1
        return count < MAX_BURST


class _QueueingHandler(logging.Handler):
    """Logging handler that writes lines in a thread, so that a blocked pipe does not delay the caller.

    An emergency stop is logged, too. The queue's kind is the one that a signal handler may put into at any moment.
    """

    def __init__(self, descriptor: int) -> None:
        super().__init__()
        self._descriptor, self._lost = descriptor, 0
        self._lines: SimpleQueue[str | threading.Event] = SimpleQueue()
        threading.Thread(target=self._write, daemon=True, name="log").start()

    def emit(self, record: logging.LogRecord) -> None:
        """Queue a formatted log record, or drop and count it if the queue is full."""
        try:
            if self._lines.qsize() >= MAX_QUEUED:
                self._lost += 1
                return
            if self._lost:
                self._lines.put(self.format(self._loss()))
            self._lines.put(self.format(record))
        except Exception:
            self.handleError(record)

    def _loss(self) -> logging.LogRecord:
        lost, self._lost = self._lost, 0
        about = {"name": __name__, "levelno": logging.WARNING, "levelname": "WARNING"}
        return logging.makeLogRecord(about | {"msg": f"{lost} lines are lost: the log was not read for a while"})

    def flush(self) -> None:
        """Wait until all queued lines are written, at most :data:`FLUSH` seconds."""
        written = threading.Event()
        self._lines.put(written)
        written.wait(FLUSH)

    def _write(self) -> None:
        while True:
            line = self._lines.get()
            if isinstance(line, threading.Event):
                line.set()
                continue
            left = f"{line}\n".encode(errors="backslashreplace")
            try:
                while left:
                    left = left[os.write(self._descriptor, left) :]
            except OSError:  # its disk is full, or its reader is gone
                self._lost += 1


def _descriptor() -> int | None:
    """Return the file descriptor of standard error; None if it was replaced by an object without one."""
    try:
        return sys.stderr.fileno()
    except (OSError, AttributeError):
        return None


def configure_logging(settings: Settings, process: str, *, waits: bool = False) -> None:
    """Configure the root logger of this process: handler, format and rate limit.

    Parameters
    ----------
    process
        The name it has in every line.
    waits
        Whether who logs waits until the line is written, as a process does that may be killed at any time.
    """
    descriptor = None if waits else _descriptor()
    handler = logging.StreamHandler() if descriptor is None else _QueueingHandler(descriptor)
    if settings.log_level != "DEBUG":
        handler.addFilter(_RateLimitFilter())
    handler.setFormatter(_Json(process) if settings.log_format == "json" else _Text(process))
    logging.basicConfig(level=settings.log_level, handlers=[handler], force=True)
