"""Strict JSON request bodies: reject duplicate keys, NaN and lone surrogates.

Large bodies are parsed in the process pool.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from typing import Any

import numpy as np
from fastapi import Request

from steradian.api.services import ServiceContainer
from steradian.core.exceptions import InvalidInput, SteradianError

INLINE_PARSE_BYTES = 64 * 2**10
"""Bytes that are parsed at once; what is larger is parsed in another process."""
LONG_LIST_ITEMS = 1000
"""Items up to which any list is taken from there."""
_ODD = re.compile("[\0\ud800-\udfff]")
"""What no database keeps as text: PostgreSQL fails at every later look into a document that holds it."""


class StrictJsonRequest(Request):
    """Request with a strict JSON parser: no duplicate keys, NaN or lone surrogates."""

    refusal: SteradianError | None = None
    """What is wrong with the body, where the framework would only say that something is."""

    async def json(self) -> Any:
        """Parse the JSON body; raises :class:`json.JSONDecodeError`, also for a body that is nested too deeply."""
        body = await self.body()
        if len(body) <= INLINE_PARSE_BYTES:
            return _parse(body)
        services: ServiceContainer = self.app.state.services
        try:
            return await services.process_pool.submit(_parse_large, body)
        except SteradianError as error:
            self.refusal = error
            raise


def _parse(body: bytes) -> Any:
    try:
        text = body.decode()
        found = json.loads(text, object_pairs_hook=_object)
        if "\\u" in text:
            _check_texts(found)
        return found
    except json.JSONDecodeError:
        raise
    except (ValueError, RecursionError) as error:
        said = "it is nested too deeply" if isinstance(error, RecursionError) else str(error)
        raise json.JSONDecodeError(said, "", 0) from None


def _parse_large(body: bytes) -> Any:
    """Parse a large JSON object in a pool process; long nested lists of numbers are returned as NumPy arrays."""
    found = _parse(body)
    if not isinstance(found, dict):
        raise InvalidInput("the body", f"of {len(body)} bytes", "an object")
    return {name: _packed(name, value) for name, value in found.items()}


def _packed(name: str, value: Any) -> Any:
    if not isinstance(value, list | dict | str) or len(value) <= LONG_LIST_ITEMS:
        return value
    try:
        array = np.array(value)
    except ValueError:  # ragged
        array = np.empty(0, object)
    if array.dtype.kind not in "if":
        raise InvalidInput(
            name, f"{type(value).__name__} of {len(value)}", f"numbers, where it is longer than {LONG_LIST_ITEMS}"
        )
    return value if array.ndim == 1 else array


def _check_texts(found: Any) -> None:
    left = [found]
    while left:
        match left.pop():
            case str(text) if odd := _ODD.search(text):
                raise ValueError(f"a text contains U+{ord(odd[0]):04X}, which is not a character")
            case list(items):
                left += items
            case dict(members):
                left += [*members, *members.values()]


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        counts = Counter(name for name, _ in pairs)
        twice = next(name for name, count in counts.items() if count > 1)
        raise ValueError(f"the key {twice[:80]!r} occurs twice in an object")
    return found
