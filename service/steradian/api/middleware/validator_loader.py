"""Loader of the cache validators of read requests, in batches."""

from __future__ import annotations

import re
from typing import Final

from starlette.types import Scope

from steradian.api.background.batcher import BatchLoader
from steradian.storage.db.database import Database
from steradian.storage.repositories.validators import MAX_CURSOR, Validator, ValidatorKey, load_validators

_THING: Final = re.compile(r"/api/v1/(masks|plans|scans|reconstructions|jobs)(?:/([a-z0-9]{1,64}))?")
_COVERAGE: Final = re.compile(r"/api/v1/(scans)/([a-z0-9]{1,64})/coverage")
"""What the scan's file holds, which grows with the scan's progress."""
_PAGE: Final = re.compile(rb"limit=([1-9][0-9]{0,2})(?:&before=([0-9]{1,9}))?")


class CacheValidatorLoader:
    """Loader of cache validators (ETag sources) of requested resources, in batches."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._looks = BatchLoader(self._look)

    async def of(self, scope: Scope) -> Validator:
        """Return the validator of the requested resource; empty when there is none.

        Raises
        ------
        DBAPIError, TimeoutError
            Those of SQLAlchemy, when the database does not answer.
        """
        question = validator_key(scope)
        return () if question is None else await self._looks.load(question)

    def _look(self, questions: tuple[ValidatorKey, ...]) -> dict[ValidatorKey, Validator]:
        with self._database.engine.connect() as connection:
            return load_validators(connection, questions)


def validator_key(scope: Scope) -> ValidatorKey | None:
    """Return the key whose validator determines whether a response is current; ``None`` if none does."""
    path, query = scope["path"], scope["query_string"]
    thing = _THING.fullmatch(path) or _COVERAGE.fullmatch(path)
    if thing is None or (thing[2] is not None and query):
        return None
    if thing[2] is not None:
        return ValidatorKey(thing[1], thing[2])
    if not query:
        return ValidatorKey(thing[1])
    page = _PAGE.fullmatch(query)
    return None if page is None else ValidatorKey(thing[1], None, int(page[1]), int(page[2] or MAX_CURSOR))
