"""Base class of the schemas of stored reports."""

from __future__ import annotations

from typing import Any

from pydantic import (
    BaseModel,
    ConfigDict,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    field_validator,
)


class ReportBase(BaseModel):
    """Base class of stored reports, which another version may have written; invalid fields become null."""

    model_config = ConfigDict(extra="allow")

    @field_validator("*", mode="wrap")
    @classmethod
    def _or_default(cls, value: Any, check: ValidatorFunctionWrapHandler, about: ValidationInfo) -> Any:
        try:
            return check(value)
        except ValidationError:
            field = cls.model_fields[about.field_name or ""]
            if field.is_required():
                raise
            return field.get_default(call_default_factory=True)
