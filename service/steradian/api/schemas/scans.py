"""Request schema of scans."""

from __future__ import annotations

from typing import Annotated

from pydantic import ConfigDict, Field, StringConstraints

from steradian.core.validation import Value

Name = Annotated[str, StringConstraints(min_length=1, max_length=60)]
Text = Annotated[str, StringConstraints(max_length=200)]


class ScanRequest(Value):
    """Request for a scan: a plan to run on a scanner."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"plan_id": "p0123456789abcdef01234567", "labels": {"phantom": "yarn"}}]}
    )

    plan_id: str = Field(min_length=1, max_length=64, description="Identifier of the plan")
    scanner_id: str | None = Field(
        default=None, min_length=1, max_length=40, description="Scanner that runs it; optional if there is one scanner"
    )
    labels: dict[Name, Text] = Field(default_factory=dict, max_length=50, description="Texts of your own")
    completes: str | None = Field(
        default=None,
        min_length=1,
        max_length=64,
        description="A scan of the same plan that is over: the new one begins with its A-lines and measures what is"
        " missing, if film and scanner prove to be as they were; the earlier one stays as it is",
    )
