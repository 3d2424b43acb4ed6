"""Idempotency keys: a repeated request gets the stored response of the first one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import timedelta

from sqlalchemy import delete, select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from steradian.core.exceptions import InvalidInput
from steradian.storage.db.database import Database
from steradian.storage.db.tables import IdempotencyRow
from steradian.storage.db.timestamps_and_ids import Clock, utc_now

LIFETIME = timedelta(hours=24)


@dataclass(frozen=True)
class IdempotencyKey:
    """Idempotency key with principal and path, and the hash of the request's body."""

    principal: str
    path: str
    text: str
    body_hash: str

    @property
    def name(self) -> str:
        """Primary key of the stored response."""
        return f"{self.principal}:{self.path}:{self.text}"


@dataclass(frozen=True)
class StoredResponse:
    """Stored response to a request with an idempotency key."""

    status: int
    location: str
    body: str
    replayed: bool = False


class IdempotencyStore:
    """Repository of responses by idempotency key."""

    def __init__(self, database: Database, clock: Clock = utc_now) -> None:
        self.database, self.clock = database, clock

    def get(self, key: IdempotencyKey | None) -> StoredResponse | None:
        """Return the stored response of a key, or ``None``; call this before checking the resource's state.

        Raises
        ------
        InvalidInput
            When the key was used with another body.
        """
        if key is None:
            return None
        with self.database.read() as session:
            return self._replay(session, key)

    def run_once(self, key: IdempotencyKey | None, make: Callable[[Session], StoredResponse]) -> StoredResponse:
        """Return the stored response of a key, or call ``make`` and store its response in the same transaction.

        Raises
        ------
        InvalidInput
            When the key was used with another body.
        """
        try:
            return self._once(key, make)
        except IntegrityError:
            if key is None:
                raise
            return self._once(key, make)  # the same request was answered beside this one

    def _once(self, key: IdempotencyKey | None, make: Callable[[Session], StoredResponse]) -> StoredResponse:
        with self.database.write() as session:
            if key is None:
                return make(session)
            if (kept := self._replay(session, key)) is not None:
                return kept
            # One that is too old only: since the look above the same request may have been answered beside this one.
            old = (IdempotencyRow.key == key.name) & (IdempotencyRow.created < self.clock() - LIFETIME)
            session.execute(delete(IdempotencyRow).where(old))
            answer = make(session)
            about = {"status": answer.status, "location": answer.location, "answer": answer.body}
            session.add(IdempotencyRow(key=key.name, created=self.clock(), body_hash=key.body_hash, **about))
            return answer

    def _replay(self, session: Session, key: IdempotencyKey) -> StoredResponse | None:
        kept = session.scalars(select(IdempotencyRow).where(IdempotencyRow.key == key.name)).one_or_none()
        if kept is None or self.clock() - kept.created > LIFETIME:
            return None
        if kept.body_hash != key.body_hash:
            raise InvalidInput("Idempotency-Key", key.text, "a key that was not used with another body")
        return StoredResponse(kept.status, kept.location, kept.answer, replayed=True)

    def prune(self) -> None:
        """Delete expired keys with their responses."""
        with self.database.write() as session:
            session.execute(delete(IdempotencyRow).where(IdempotencyRow.created < self.clock() - LIFETIME))
