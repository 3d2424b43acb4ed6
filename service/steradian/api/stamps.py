"""Whether the answer to a light read is still right: asked of the database in one look for all who wait."""

from __future__ import annotations

import asyncio
import re
from concurrent.futures import ThreadPoolExecutor
from typing import Final

from starlette.types import Scope

from steradian.storage.database import Database
from steradian.storage.stamps import ANY_BEFORE, Question, Stamp, look

_THING: Final = re.compile(r"/api/v1/(masks|plans|scans|reconstructions|jobs)(?:/([a-z0-9]{1,64}))?")
_PAGE: Final = re.compile(rb"limit=([1-9][0-9]{0,2})(?:&before=([0-9]{1,9}))?")


class Stamps:
    """Looks at stamps in a thread of its own, one look after the other.

    A look that has begun answers nobody who asks later, so that no stamp is older than its question.
    """

    def __init__(self, database: Database) -> None:
        self._database = database
        self._thread = ThreadPoolExecutor(1, "stamps")
        self._asked: dict[Question, asyncio.Future[Stamp]] = {}
        self._task: asyncio.Task[None] | None = None

    async def of(self, scope: Scope) -> Stamp:
        """Return the stamp of what a request asks for; an empty one where there is none, or nothing.

        Raises
        ------
        DBAPIError
            When the database does not answer.
        """
        question = question_of(scope)
        if question is None:
            return ()
        if question not in self._asked:
            self._asked[question] = asyncio.get_running_loop().create_future()
            if self._task is None:
                self._task = asyncio.create_task(self._answer())
        return await asyncio.shield(self._asked[question])

    async def _answer(self) -> None:
        while self._asked:
            asked, self._asked = self._asked, {}
            try:
                found = await asyncio.get_running_loop().run_in_executor(self._thread, self._look, tuple(asked))
            except Exception as error:
                for future in asked.values():
                    future.set_exception(error)
            else:
                for question, future in asked.items():
                    future.set_result(found[question])
        self._task = None

    def _look(self, questions: tuple[Question, ...]) -> dict[Question, Stamp]:
        with self._database.engine.connect() as connection:
            return look(connection, questions)


def question_of(scope: Scope) -> Question | None:
    """Tell what must be stamped as it was for an answer to be still right; ``None`` where a stamp does not tell."""
    thing, query = _THING.fullmatch(scope["path"]), scope["query_string"]
    if thing is None or (thing[2] is not None and query):
        return None
    if thing[2] is not None:
        return Question(thing[1], thing[2])
    if not query:
        return Question(thing[1])
    page = _PAGE.fullmatch(query)
    return None if page is None else Question(thing[1], None, int(page[1]), int(page[2] or ANY_BEFORE))
