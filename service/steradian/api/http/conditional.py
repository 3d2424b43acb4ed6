"""Conditional requests: ETag, If-None-Match for reads, If-Match for writes."""

from __future__ import annotations

import hashlib
import os
import re
from pathlib import Path
from typing import Annotated, TypeAlias

from fastapi import Depends, Header, Response
from pydantic import BaseModel
from werkzeug.http import parse_etags

from steradian.storage.repositories.scans import RevisionConflict


class NotModified(Exception):
    """Control-flow exception: the client's cached representation is still current (304)."""

    def __init__(self, etag: str, vary: str | None) -> None:
        self.headers = {"ETag": etag} | ({"Vary": vary} if vary else {})
        super().__init__(etag)


class ReadPreconditions:
    """Preconditions of a read request: If-Match and If-None-Match."""

    def __init__(self, response: Response, match: str | None, none_match: str | None) -> None:
        self._response, self._match, self._none_match = response, match, none_match

    def tag(self, etag: str, *, vary: str | None = None) -> None:
        """Set the ETag of the response, after a check of If-Match and If-None-Match.

        If-None-Match compares weakly, because a proxy that compresses a response makes its ETag weak.

        Parameters
        ----------
        vary
            The header of the request that chose this representation, if there are several.

        Raises
        ------
        RevisionConflict
            When If-Match names other versions only.
        NotModified
            When the client already has this version.
        """
        name = etag.strip('"')
        if self._match is not None and not parse_etags(self._match).contains(name):
            raise RevisionConflict(f"{self._match} is not the current version, {etag}")
        if self._none_match is not None and parse_etags(self._none_match).contains_weak(name):
            raise NotModified(etag, vary)
        self._response.headers["ETag"] = etag


class WritePreconditions:
    """Precondition of a modifying request: If-Match."""

    def __init__(self, response: Response, match: str | None) -> None:
        self._response, self._match = response, match

    def tag(self, etag: str) -> None:
        """Set the ETag of the response to that of the changed resource."""
        self._response.headers["ETag"] = etag

    def revision(self, identifier: str) -> int | None:
        """Return the revision of a resource that If-Match requires; ``None`` without a requirement.

        A weak ETag is valid, too: a proxy that compresses makes our ETags weak, but the revision in them is unchanged.

        Raises
        ------
        RevisionConflict
            When If-Match names no revision of this resource.
        """
        if self._match is None:
            return None
        tags = parse_etags(self._match)
        if tags.star_tag:
            return None
        for tag in filter(None, tags.as_set(include_weak=True)):  # an empty one is read as none
            found = re.fullmatch(rf"{re.escape(identifier)}-([0-9]{{1,18}})(-[0-9a-f]+)?", tag)
            if found:
                return int(found[1])
        raise RevisionConflict(f"{self._match} is not a version of {identifier}")


Match: TypeAlias = Annotated[
    str | None, Header(alias="If-Match", description="ETag that the resource must still have; else 412")
]


async def _conditions(  # as is the next one: a plain function would be called in another thread
    response: Response,
    if_match: Match = None,
    if_none_match: Annotated[
        str | None,
        Header(alias="If-None-Match", description="ETag of the copy that the client has; 304 if it is current"),
    ] = None,
) -> ReadPreconditions:
    return ReadPreconditions(response, if_match, if_none_match)


async def _change_conditions(response: Response, if_match: Match = None) -> WritePreconditions:
    return WritePreconditions(response, if_match)


def resource_etag(identifier: str, revision: int | str, view: BaseModel | None = None) -> str:
    """Return the ETag of a resource's revision, or of one view of that revision.

    Progress and queue position, for example, are part of ``view`` but not of the ``revision``, so that If-Match does
    not reject a change because of them.
    """
    if view is None:
        return f'"{identifier}-{revision}"'
    shown = hashlib.blake2s(view.model_dump_json().encode(), digest_size=6)
    return f'"{identifier}-{revision}-{shown.hexdigest()}"'


def etag_of_file(path: Path, file: int | None = None, *, kind: str | None = None) -> str:
    """Return an ETag from a file's modification time and size; those of the open descriptor ``file``, if given.

    Parameters
    ----------
    kind
        Media type of the representation, if the file has several.
    """
    found = path.stat() if file is None else os.stat(file)
    form = f"-{kind.rpartition('/')[2]}" if kind else ""
    return f'"{path.stem}-{found.st_mtime_ns:x}-{found.st_size:x}{form}"'


ReadPreconditionsDep: TypeAlias = Annotated[ReadPreconditions, Depends(_conditions)]
WritePreconditionsDep: TypeAlias = Annotated[WritePreconditions, Depends(_change_conditions)]
