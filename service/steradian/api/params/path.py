"""Path-parameter types for resource identifiers."""

from __future__ import annotations

from typing import Annotated, Any, TypeAlias

from fastapi import Path


def _identifier(what: str, example: str) -> Any:
    return Path(description=f"Identifier of the {what}", max_length=64, examples=[example])


MASK_ID: TypeAlias = Annotated[str, _identifier("mask", "m0123456789abcdef01234567")]
PLAN_ID: TypeAlias = Annotated[str, _identifier("plan", "p0123456789abcdef01234567")]
SCAN_ID: TypeAlias = Annotated[str, _identifier("scan", "s01jz0000000000000000000000")]
RECONSTRUCTION_ID: TypeAlias = Annotated[str, _identifier("reconstruction", "r01jz0000000000000000000000")]
BATCH_ID: TypeAlias = Annotated[str, _identifier("batch", "b01jz0000000000000000000000")]
JOB_ID: TypeAlias = Annotated[str, _identifier("job", "j01jz0000000000000000000000")]
FILE_NAME: TypeAlias = Annotated[str, Path(description="Name of the file", max_length=120, examples=["quality.json"])]
UPLOAD_ID: TypeAlias = Annotated[str, _identifier("upload", "u01jz0000000000000000000000")]
SCANNER_ID: TypeAlias = Annotated[str, _identifier("scanner", "scanner-0")]
