"""Descriptions and units in JSON schemas, taken from the docstrings of dataclasses."""

from __future__ import annotations

import inspect
import re
from typing import Any

from pydantic import GetJsonSchemaHandler
from pydantic_core import CoreSchema

_NAME = re.compile(r"(\w+)$")
_ASIDE = re.compile(r"\s*\(:\w+:`[^`]*`\)")
_ROLE = re.compile(r":\w+:`~?\.*([^`]*)`")


def explanations(kind: type) -> dict[str, str]:
    """Return the description of each parameter in the NumPy docstring of a class."""
    _, _, section = (inspect.getdoc(kind) or "").partition("Parameters\n----------\n")
    found: dict[str, list[str]] = {}
    lines: list[str] = []
    for line in section.splitlines():
        if name := _NAME.match(line):
            lines = found.setdefault(name[1], [])
        elif line and not line.startswith(" "):
            break
        else:
            lines.append(line.strip())
    return {name: _plain(" ".join(text)) for name, text in found.items()}


def _plain(text: str) -> str:
    return " ".join(_ROLE.sub(r"\1", _ASIDE.sub("", text)).replace("``", "").split())


class SchemaDescriptions:
    """Pydantic annotation that adds a dataclass's docstring descriptions and given units to its JSON schema."""

    def __init__(self, kind: type, **units: str) -> None:
        self._kind, self._units = kind, units

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Return the JSON schema with descriptions and units added to its properties."""
        made = handler(schema)
        properties: dict[str, dict[str, Any]] = handler.resolve_ref_schema(made)["properties"]
        for name, text in explanations(self._kind).items():
            properties[name].setdefault("description", text)
        for name, unit in self._units.items():
            properties[name]["unit"] = unit
        return made
