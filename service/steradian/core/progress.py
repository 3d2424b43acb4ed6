"""Callback types for the progress and the cancellation of long operations."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

Progress: TypeAlias = Callable[[str, int, int], None]
"""Called as ``progress(stage, done, total)``; ``stage`` is a short English phrase, counts are of its own unit."""

CancelCheck: TypeAlias = Callable[[], bool]
"""Asked between pieces of work; ``True`` makes the work raise :class:`steradian.core.exceptions.Cancelled`."""
