"""Batching loader: loads the keys of concurrent requests with one call in a worker thread."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Generic, TypeVar

K = TypeVar("K")
Answer = TypeVar("Answer")


class BatchLoader(Generic[K, Answer]):
    """Batching loader of values by key; keys requested during a batch are loaded by the next one, so no value is stale.

    A batch in progress does not answer later requests, so that no value is older than its request.

    Parameters
    ----------
    look
        Function that returns the values of several distinct keys.
    """

    def __init__(self, look: Callable[[tuple[K, ...]], Mapping[K, Answer]]) -> None:
        self._look = look
        self._thread = ThreadPoolExecutor(1, "looks")
        self._asked: dict[K, asyncio.Future[Answer]] = {}
        self._task: asyncio.Task[None] | None = None

    async def load(self, question: K) -> Answer:
        """Load a key with the next batch and return its value; raises the exception of the batch function."""
        if question not in self._asked:
            self._asked[question] = asyncio.get_running_loop().create_future()
            if self._task is None:
                self._task = asyncio.create_task(self._answer())
        return await asyncio.shield(self._asked[question])

    async def _answer(self) -> None:
        try:
            while self._asked:
                asked, self._asked = self._asked, {}
                try:
                    found = await asyncio.get_running_loop().run_in_executor(self._thread, self._look, tuple(asked))
                    answers = {question: found[question] for question in asked}
                except Exception as error:
                    for future in asked.values():
                        future.set_exception(error)
                else:
                    for question, future in asked.items():
                        future.set_result(answers[question])
        finally:
            self._task = None  # however it ended, who asks next is answered
