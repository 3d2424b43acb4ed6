"""Base class of immutable, validated values (pydantic models), and field helpers."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    PlainSerializer,
    ValidationError,
    WithJsonSchema,
)
from pydantic_core import CoreSchema, PydanticKnownError, core_schema

from steradian.core.validation_errors import to_invalid_input


def _no_boolean(kind: Literal["int", "float"]) -> Callable[[object], object]:
    def check(value: object) -> object:
        if isinstance(value, bool | np.bool_):
            raise PydanticKnownError("int_type" if kind == "int" else "float_type")
        return value

    return check


_CHECKS = {"int": _no_boolean("int"), "float": _no_boolean("float")}


def _reject_booleans(schema: Any) -> None:
    """Add a validator that rejects booleans to each number in a pydantic core schema."""
    for key, part in list(schema.items() if isinstance(schema, dict) else enumerate(schema)):
        if key in {"metadata", "serialization"} or not isinstance(part, dict | list):
            continue
        kind = part.get("type") if isinstance(part, dict) else None
        if kind in _CHECKS:
            schema[key] = core_schema.no_info_before_validator_function(_CHECKS[kind], part)  # type: ignore[arg-type]
        elif kind != "function-before" or part["function"]["function"] not in _CHECKS.values():  # type: ignore[call-overload]
            _reject_booleans(part)


class Value(BaseModel):
    """Base class of immutable pydantic models; :meth:`create` raises ``InvalidInput`` on invalid fields.

    No boolean counts as a number, in whatever field: ``true`` is no aperture of 1 m.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True, allow_inf_nan=False)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the core schema with booleans rejected in numeric fields."""
        schema = handler(source)
        _reject_booleans(handler.resolve_ref_schema(schema))
        return schema

    @classmethod
    def create(cls, **fields: Any) -> Self:
        """Return a validated instance with these fields.

        Raises
        ------
        InvalidInput
            For the first field that is missing, unknown or out of range.
        """
        try:
            return cls(**fields)
        except ValidationError as error:
            raise to_invalid_input(cls, error) from error

    def replace(self, **changes: Any) -> Self:
        """Return a validated copy with some fields changed (``model_copy`` would keep a stale identifier)."""
        return self.create(**{name: getattr(self, name) for name in type(self).model_fields} | changes)


def quantity_field(unit: str, description: str, **limits: Any) -> Any:
    """Return a pydantic field with a unit, which appears in errors and in the JSON schema."""
    return Field(description=f"{description} ({unit})", json_schema_extra={"unit": unit}, **limits)


def _as_float64(value: object) -> NDArray[np.float64]:
    try:
        array = np.array(value, dtype=np.float64, order="C")
        if not {bool, np.bool_}.isdisjoint(map(type, np.array(value, dtype=object).flat)):
            raise ValueError("a boolean is not a number")
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"not an array of numbers: {error}") from None
    if not array.ndim:
        raise ValueError("not an array of numbers but one")
    return array


def _frozen_finite(value: NDArray[np.float64]) -> NDArray[np.float64]:
    if not np.isfinite(value).all():
        raise ValueError(
            f"finite numbers only; the first non-finite value is at {np.argwhere(~np.isfinite(value))[0].tolist()}"
        )
    value.setflags(write=False)
    return value


FloatArray = Annotated[
    # NDArray has a name of its own from NumPy 2.5 on, which would change the schema.
    np.ndarray[Any, np.dtype[np.float64]],
    BeforeValidator(_as_float64),
    AfterValidator(_frozen_finite),
    PlainSerializer(lambda array: array.tolist(), return_type=list, when_used="json"),
    WithJsonSchema(
        {"type": "array", "items": {"anyOf": [{"type": "number"}, {"type": "array", "items": {"type": "number"}}]}}
    ),
]
"""A read-only, finite float64 array; nested lists in JSON."""


def content_hash(prefix: str, parameters: object, *arrays: NDArray[Any]) -> str:
    """Return an identifier of immutable content: ``prefix`` and 24 hexadecimal digits of a SHA-256.

    The parameters enter as JSON with sorted keys, the arrays as little-endian bytes, so the same content has the
    same identifier on every machine.
    """
    digest = hashlib.sha256(json.dumps(parameters, sort_keys=True, separators=(",", ":")).encode())
    for array in arrays:
        digest.update(str(array.shape).encode())
        digest.update(np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<")).tobytes())
    return prefix + digest.hexdigest()[:24]
