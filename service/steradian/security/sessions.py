"""Browser sessions: sign-in with an API key for 12 hours, without exposing the key to scripts.

Only hashes of the secrets are stored. The CSRF token is derived from the secret, so that it is valid as long as the
session and on every node of the service.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Final

from sqlalchemy import delete, select

from steradian.security.keys import KeyStore, Principal, Unauthorized
from steradian.storage.db.database import Database
from steradian.storage.db.tables import SessionRow
from steradian.storage.db.timestamps_and_ids import Clock, utc_now

LIFETIME: Final = timedelta(hours=12)
"""For how long a session lasts; a key that ends earlier ends it, too."""
MOST: Final = 50
"""Sessions of one key; the oldest ends when there is one more."""
_WORTHLESS = "the session is over; sign in again"


@dataclass(frozen=True)
class ValidSession:
    """Authenticated browser session: principal, CSRF token and expiry.

    Attributes
    ----------
    principal
        Principal of the key with which the session was opened.
    csrf_token
        Token that every request with side effects must send.
    expires
        Time of expiry.
    """

    principal: Principal
    csrf_token: str
    expires: datetime


class SessionStore:
    """Store of browser sessions: open, check and revoke."""

    def __init__(self, database: Database, keys: KeyStore, clock: Clock = utc_now) -> None:
        self.database, self.keys, self.clock = database, keys, clock
        self._remembered: Mapping[str, SessionRow] = {}

    def open(self, principal: Principal) -> str:
        """Create a session for a principal with an API key, and return its secret (the cookie's value).

        Raises
        ------
        Unauthorized
            When the principal has no key.
        """
        issuer = self.keys.key_id(principal)
        if issuer is None:
            raise Unauthorized("send the key that the session is to be of: Authorization: Bearer …")
        secret, now = secrets.token_urlsafe(32), self.clock()
        of_key = select(SessionRow.hash).where(SessionRow.issuer == issuer)
        with self.database.write() as session:
            session.execute(delete(SessionRow).where(SessionRow.expires < now))
            kept = session.scalars(of_key.order_by(SessionRow.created.desc()).limit(MOST - 1)).all()
            session.execute(delete(SessionRow).where(SessionRow.issuer == issuer, SessionRow.hash.not_in(kept)))
            session.add(SessionRow(hash=_hash(secret), issuer=issuer, created=now, expires=now + LIFETIME))
        return secret

    def check(self, secret: str) -> ValidSession:
        """Authenticate a session by its secret; raises :class:`Unauthorized` if it or its key is no longer valid."""
        with self.database.read() as session:
            row = session.get(SessionRow, _hash(secret))
        return self._seen(secret, row, from_memory=False)

    def remember(self) -> None:
        """Reload the caches of API keys and sessions from the database, for :meth:`check_cached`."""
        self.keys.refresh_cache()
        with self.database.read() as session:
            self._remembered = {row.hash: row for row in session.scalars(select(SessionRow))}

    def check_cached(self, secret: str) -> ValidSession:
        """Authenticate a session from the cache; raises :class:`Unauthorized`."""
        return self._seen(secret, self._remembered.get(_hash(secret)), from_memory=True)

    def revoke(self, secret: str) -> None:
        """Delete a session, so that its secret is invalid at once."""
        with self.database.write() as session:
            session.execute(delete(SessionRow).where(SessionRow.hash == _hash(secret)))

    def _seen(self, secret: str, row: SessionRow | None, *, from_memory: bool) -> ValidSession:
        if row is None or row.expires < self.clock():
            raise Unauthorized(_WORTHLESS)
        principal = self.keys.principal_of_key(row.issuer, from_memory=from_memory)
        return ValidSession(principal, csrf_token(secret), row.expires)


def csrf_token(secret: str) -> str:
    """Derive the CSRF token of a session from its secret by HMAC."""
    return hmac.new(secret.encode(), b"steradian csrf token", hashlib.sha256).hexdigest()


def _hash(secret: str) -> str:
    return hashlib.sha256(secret.encode()).hexdigest()
