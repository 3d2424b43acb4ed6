"""Request bodies: JSON whose every key says one thing, so that no two readers of it understand two."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from fastapi import Request

from steradian.api.services import Services
from steradian.errors import InvalidInput, SteradianError

SMALL = 64 * 2**10
"""Bytes that are parsed at once; what is larger is parsed in another process."""
LONG = 1000
"""Items up to which any list is taken from there."""


class JsonRequest(Request):
    """A request whose body is JSON in which no object has a key twice."""

    refusal: SteradianError | None = None
    """What is wrong with the body, where the framework would only say that something is."""

    async def json(self) -> Any:
        """Parse the body; raises :class:`json.JSONDecodeError` also for what makes a parser give up."""
        body = await self.body()
        if len(body) <= SMALL:
            return _parse(body)
        services: Services = self.app.state.services
        try:
            return await services.workshop.work(_parse_large, body)
        except SteradianError as error:
            self.refusal = error
            raise


def _parse(body: bytes) -> Any:
    try:
        return json.loads(body.decode("utf-8", "replace"), object_pairs_hook=_object)
    except json.JSONDecodeError:
        raise
    except (ValueError, RecursionError) as error:
        said = "it is nested too deep" if isinstance(error, RecursionError) else str(error)
        raise json.JSONDecodeError(said, "", 0) from None


def _parse_large(body: bytes) -> Any:
    """Parse elsewhere; long lists come back as arrays, which are checked at once and not number by number."""
    found = _parse(body)
    if not isinstance(found, dict):
        raise InvalidInput("the body", f"of {len(body)} bytes", "an object")
    return {name: _packed(name, value) for name, value in found.items()}


def _packed(name: str, value: Any) -> Any:
    if not isinstance(value, list | dict | str) or len(value) <= LONG:
        return value
    try:
        array = np.array(value)
    except ValueError:  # ragged
        array = np.empty(0, object)
    if array.dtype.kind not in "if":
        raise InvalidInput(name, f"{type(value).__name__} of {len(value)}", f"numbers, where it is longer than {LONG}")
    return value if array.ndim == 1 else array


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"the key {twice[:80]!r} stands twice in an object")
    return found
