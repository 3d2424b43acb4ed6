"""Conversion of validation errors to field errors with the allowed range."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from fastapi import Request
from pydantic import BaseModel, Field

from steradian.core.exceptions import InvalidInput
from steradian.core.validation_errors import describe_range
from steradian.jobs.requests import WorkRequest
from steradian.masks import ARRANGEMENTS

_TAGS = {
    "arrangement": ", ".join(ARRANGEMENTS),
    "kind": ", ".join(model.model_fields["kind"].default for model in get_args(WorkRequest)),
}
"""The fields that tell the members of a union apart, and their values."""
_PLACES = {"body": "body", "query": "query", "header": "header", "path": "path"}


class Finding(BaseModel):
    """Field error: an invalid field or parameter, with its value and allowed range."""

    place: Literal["body", "query", "header", "path"] = Field(description="Where it was given")
    pointer: str = Field(description="JSON pointer into the body, or the parameter's name", examples=["#/depth"])
    allowed: str = Field(description="The allowed range, with units", examples=["> 0, at most 1 (m)"])
    detail: str = Field(examples=["depth is -0.001; allowed: > 0, at most 1 (m)"])


def field_error(error: InvalidInput, request: Request) -> Finding:
    """Convert :class:`InvalidInput` to a field error; fields named like headers are headers."""
    named: Literal["header", "query"] | None = "header" if error.field[:1].isupper() else None
    named = "query" if error.field in request.query_params or request.method in ("GET", "HEAD") else named
    if named:
        return Finding(place=named, pointer=error.field, allowed=error.allowed, detail=str(error))
    return Finding(place="body", pointer=_pointer(error.field), allowed=error.allowed, detail=str(error))


def field_errors(request: Request, errors: Sequence[Mapping[str, Any]], body: object) -> list[Finding]:
    """Convert pydantic's validation errors of a request to field errors."""
    model = getattr(getattr(request.scope.get("route"), "body_field", None), "field_info", None)
    return [_finding(error, body, getattr(model, "annotation", None)) for error in errors]


def _finding(error: Mapping[str, Any], body: object, annotation: object) -> Finding:
    place, *path = [str(part) for part in error["loc"]]
    if place == "body":
        path = _without_tags(path, body)
    cause = error.get("ctx", {}).get("error")
    if isinstance(cause, InvalidInput):
        pointer = "/".join([*path, cause.field.replace(".", "/")])
        return Finding(place="body", pointer=f"#/{pointer}", allowed=cause.allowed, detail=str(cause))
    allowed = _allowed(annotation, path, body) if place == "body" else ""
    allowed = allowed or _limit(error)
    if place == "query":
        path = path[:1]  # without the place in a list
    name = ".".join(path) or "the body"
    tag = str(error.get("ctx", {}).get("discriminator", "")).strip("'")
    if error["type"] == "union_tag_invalid":
        path = [*path, tag]
        detail = f"{tag} is {_short(error['ctx'].get('tag'))}"
    elif error["type"] == "union_tag_not_found":
        path, detail, allowed = [*path, tag], f"{tag} is missing", _TAGS.get(tag, "")
    elif error["type"] == "value_error":
        detail, allowed = f"{name}: {allowed}", ""
    elif error["type"] == "missing":
        detail = f"{name} is missing"
    elif error["type"] == "unknown_query":
        detail = f"{name} is not a parameter of this address"
    elif error["type"] == "extra_forbidden":
        detail, allowed = f"{name} is not a known field", "no such field"
    else:
        detail = f"{name} is {_short(error.get('input'))}"
    detail += f"; allowed: {allowed}" if allowed and error["type"] != "extra_forbidden" else ""
    return Finding(
        place=_PLACES.get(place, "body"),  # type: ignore[arg-type]
        pointer="#" + "".join(f"/{part}" for part in path) if place == "body" else name,
        allowed=allowed,
        detail=detail,
    )


def _without_tags(path: list[str], body: object) -> list[str]:
    """Remove union discriminator tags from an error's location, because fields do not have these names."""
    found, here = [], body
    for part in path:
        if isinstance(here, dict):
            if part not in here and part in [here.get(tag) for tag in _TAGS]:
                continue
            here = here.get(part)
        found.append(part)
    return found


def _limit(error: Mapping[str, Any]) -> str:
    """Return the text of the limit that a pydantic error contains."""
    context = error.get("ctx", {})
    words = {"gt": "> {}", "ge": "at least {}", "lt": "< {}", "le": "at most {}", "expected": "{}"}
    said = [word.format(context[key]) for key, word in words.items() if key in context]
    if "expected_tags" in context:
        said.append(str(context["expected_tags"]))
    return ", ".join(said) or str(error["msg"]).removeprefix("Input should be ").removeprefix("Value error, ")


def _allowed(annotation: object, path: list[str], body: object) -> str:
    """Return the text of a field's allowed range, with its unit, from its pydantic model."""
    if path and path[0].isdigit():  # index of a list
        path = path[1:]
    if not path:
        return ""
    for model in _models(annotation):
        if isinstance(body, dict) and any(
            tag in model.model_fields and body.get(tag) not in get_args(model.model_fields[tag].annotation)
            for tag in _TAGS
        ):
            continue
        info = model.model_fields.get(path[0])
        if info is not None:
            inner = body.get(path[0]) if isinstance(body, dict) else None
            return describe_range(info) if len(path) == 1 else _allowed(info.annotation, path[1:], inner)
    return ""


def _models(annotation: object) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    elif get_origin(annotation) in (Union, UnionType, Annotated, tuple, list):
        for part in get_args(annotation):
            yield from _models(part)


def _pointer(field: str) -> str:
    return "#/" + field.replace(".", "/").replace("[", "/").replace("]", "")


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."
