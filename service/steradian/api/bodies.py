"""Request bodies: JSON whose every key says one thing, so that no two readers of it understand two."""

from __future__ import annotations

import json
from typing import Any

from fastapi import Request


class JsonRequest(Request):
    """A request whose body is JSON in which no object has a key twice."""

    async def json(self) -> Any:
        """Parse the body; raises :class:`json.JSONDecodeError` also for what makes a parser give up."""
        text = (await self.body()).decode("utf-8", "replace")
        try:
            return json.loads(text, object_pairs_hook=_object)
        except json.JSONDecodeError:
            raise
        except (ValueError, RecursionError) as error:
            said = "it is nested too deep" if isinstance(error, RecursionError) else str(error)
            raise json.JSONDecodeError(said, "", 0) from None


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"the key {twice[:80]!r} stands twice in an object")
    return found
