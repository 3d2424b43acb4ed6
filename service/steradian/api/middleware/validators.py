"""Load cache validators of read requests in batches."""

from __future__ import annotations

import re
from typing import Final

from starlette.types import Scope

from steradian.api.background.batcher import Looks
from steradian.storage.db.database import Database
from steradian.storage.repositories.validators import ANY_BEFORE, Question, Stamp, look

_THING: Final = re.compile(r"/api/v1/(masks|plans|scans|reconstructions|jobs)(?:/([a-z0-9]{1,64}))?")
_COVERAGE: Final = re.compile(r"/api/v1/(scans)/([a-z0-9]{1,64})/coverage")
"""What the scan's file holds, which grows with the scan's progress."""
_PAGE: Final = re.compile(rb"limit=([1-9][0-9]{0,2})(?:&before=([0-9]{1,9}))?")


class Stamps:
    """Looks at stamps."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._looks = Looks(self._look)

    async def of(self, scope: Scope) -> Stamp:
        """Return the validator of the requested resource; empty when there is none.

        Raises
        ------
        DBAPIError, TimeoutError
            Those of SQLAlchemy, when the database does not answer.
        """
        question = question_of(scope)
        return () if question is None else await self._looks.ask(question)

    def _look(self, questions: tuple[Question, ...]) -> dict[Question, Stamp]:
        with self._database.engine.connect() as connection:
            return look(connection, questions)


def question_of(scope: Scope) -> Question | None:
    """Return the key whose validator determines whether a response is current; ``None`` if none does."""
    path, query = scope["path"], scope["query_string"]
    thing = _THING.fullmatch(path) or _COVERAGE.fullmatch(path)
    if thing is None or (thing[2] is not None and query):
        return None
    if thing[2] is not None:
        return Question(thing[1], thing[2])
    if not query:
        return Question(thing[1])
    page = _PAGE.fullmatch(query)
    return None if page is None else Question(thing[1], None, int(page[1]), int(page[2] or ANY_BEFORE))
