"""Conversion of pydantic validation errors to InvalidInput, with the limits and unit of the field.

A person reads "depth is -1; allowed: > 0, at most 1 (m)", not a library's error dump.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import get_args

import annotated_types
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from steradian.core.exceptions import InvalidInput

_SECRETS = re.compile(r"(?<=://)[^/]*(?=@)|(?<=\?).*")
"""Where an address may hold a name, password or token."""


def to_invalid_input(model: type[BaseModel], error: ValidationError) -> InvalidInput:
    """Convert the first error of a pydantic ``ValidationError`` to an ``InvalidInput`` with field, value and range."""
    first = error.errors(include_url=False)[0]
    path = [str(part) for part in first["loc"]]
    field = ".".join(path) or model.__name__
    info = find_field(model, path)
    cause = first.get("ctx", {}).get("error")
    if isinstance(cause, InvalidInput):
        return cause
    if first["type"] == "missing":
        return InvalidInput(field, "missing", describe_range(info) if info else "a value")
    if first["type"] == "extra_forbidden":
        return InvalidInput(field, first["input"], f"only the fields {', '.join(model.model_fields)}")
    said = describe_range(info) if info is not None else ""
    value = first["input"]
    if info is not None and not info.repr:
        value = "…"
    elif isinstance(value, str):
        value = _SECRETS.sub("…", value)
    return InvalidInput(field, value, said or str(cause or first["msg"]))


def find_field(annotation: object, path: Sequence[str]) -> FieldInfo | None:
    """Return the field at a path of names and list indices, in a model or a type that contains models."""
    if path and path[0].isdigit():
        path = path[1:]
    if not path:
        return None
    if not (isinstance(annotation, type) and issubclass(annotation, BaseModel)):
        found = (find_field(part, path) for part in get_args(annotation))
        return next((info for info in found if info is not None), None)
    info = annotation.model_fields.get(path[0])
    return info if info is None or len(path) == 1 else find_field(info.annotation, path[1:])


def describe_range(info: FieldInfo) -> str:
    """Return a field's limits in words, for example ``"> 0, at most 1 (m)"``; empty without limits."""
    words = []
    for limit in info.metadata:
        match limit:
            case annotated_types.Gt(gt=bound):
                words.append(f"> {bound:g}")
            case annotated_types.Ge(ge=bound):
                words.append(f"at least {bound:g}")
            case annotated_types.Lt(lt=bound):
                words.append(f"< {bound:g}")
            case annotated_types.Le(le=bound):
                words.append(f"at most {bound:g}")
            case _:
                pass
    if not words:
        return ""
    extra = info.json_schema_extra
    unit = extra.get("unit") if isinstance(extra, dict) else None
    return ", ".join(words) + (f" ({unit})" if unit else "")
