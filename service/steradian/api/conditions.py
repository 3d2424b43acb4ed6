"""Preconditions (RFC 9110): ETags, If-None-Match before anything is read, If-Match before anything is changed."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Annotated, TypeAlias

from fastapi import Depends, Header, Response

from steradian.storage.scans import Outdated


class NotModified(Exception):
    """What the client has is still right."""

    def __init__(self, etag: str) -> None:
        self.etag = etag
        super().__init__(etag)


class Conditions:
    """The preconditions of one request."""

    def __init__(self, response: Response, match: str | None, none_match: str | None) -> None:
        self._response, self._match, self._none_match = response, match, none_match

    def tag(self, etag: str) -> None:
        """State the ETag of the answer; raises :class:`NotModified` when the client has it already."""
        if self._none_match is not None and (self._none_match.strip() == "*" or etag in _tags(self._none_match)):
            raise NotModified(etag)
        self._response.headers["ETag"] = etag

    def revision(self, identifier: str) -> int | None:
        """Return the revision that the client wants to change; ``None`` when any will do.

        Raises
        ------
        Outdated
            When If-Match names no revision of this resource.
        """
        if self._match is None or self._match.strip() == "*":
            return None
        for tag in _tags(self._match):
            name, _, number = tag.strip('"').rpartition("-")
            if name == identifier and re.fullmatch("[0-9]{1,18}", number):
                return int(number)
        raise Outdated(f"{self._match} is no version of {identifier}")


def _conditions(
    response: Response,
    if_match: Annotated[str | None, Header(description="ETag that the resource must still have")] = None,
    if_none_match: Annotated[str | None, Header(description="ETag that you have; 304 if it is still right")] = None,
) -> Conditions:
    return Conditions(response, if_match, if_none_match)


def _tags(header: str) -> set[str]:
    return {tag.strip() for tag in header.split(",")}


def etag_of(identifier: str, revision: int | str) -> str:
    """Name a version of a resource."""
    return f'"{identifier}-{revision}"'


def etag_of_file(path: Path, file: int | None = None) -> str:
    """Name a version of a file by its time and size; of the one that is open as ``file``, if that is given."""
    found = path.stat() if file is None else os.stat(file)
    return f'"{path.stem}-{found.st_mtime_ns:x}-{found.st_size:x}"'


ConditionsNeeded: TypeAlias = Annotated[Conditions, Depends(_conditions)]
