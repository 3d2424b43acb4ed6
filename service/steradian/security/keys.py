"""API keys, stored as SHA-256 hashes (one round, because the secrets are random)."""

from __future__ import annotations

import hashlib
import hmac
import secrets
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from datetime import timedelta
from enum import StrEnum

from sqlalchemy import select
from sqlalchemy.orm import Session

from steradian.core.exceptions import InvalidInput, NotFound, SteradianError
from steradian.storage.db.database import Database, advisory_xact_lock
from steradian.storage.db.tables import ApiKeyRow
from steradian.storage.db.timestamps_and_ids import Clock, utc_now

PREFIX = "sk"
FIRST_LOCK = 0x57E2AD1F
"""Number of the PostgreSQL advisory lock under which a first key is made."""
LONGEST_NAME = 100
"""Characters; what a principal is called has twenty more and is written down in columns of 120."""


class Scope(StrEnum):
    """Permission of a key; ``admin`` includes all others."""

    READ = "read"
    PLAN = "plan"
    OPERATE = "operate"
    RECONSTRUCT = "reconstruct"
    ADMIN = "admin"


class Unauthorized(SteradianError):
    """Error: the request has no valid credentials."""

    code = "unauthorized"


class Forbidden(SteradianError):
    """Error: the caller's key does not have the required scope."""

    code = "forbidden"


@dataclass(frozen=True)
class Principal:
    """Authenticated caller of a request, with their scopes."""

    name: str
    scopes: frozenset[Scope]
    key_id: str | None = None
    """Identifier of the key that proved it."""

    def may(self, scope: Scope) -> bool:
        """Return whether the principal has a scope."""
        return Scope.ADMIN in self.scopes or scope in self.scopes


_SETTINGS = Principal("settings", frozenset({Scope.ADMIN}))


class KeyStore:
    """Store of API keys: create, check and revoke.

    Parameters
    ----------
    fixed
        Admin key from the settings, which is not stored in the database.
    """

    def __init__(self, database: Database, clock: Clock = utc_now, fixed: str | None = None) -> None:
        self.database, self.clock = database, clock
        self._remembered: dict[str, ApiKeyRow] = {}
        self._fixed = None if fixed is None else _hash(fixed)

    def create(self, name: str, scopes: Iterable[Scope], lifetime: timedelta | None = None) -> str:
        """Create an API key and return it; only its hash is stored."""
        with self.database.write() as session:
            return self._create(session, name, scopes, lifetime)

    def create_first(self, name: str, scopes: Iterable[Scope], keep: Callable[[str], object]) -> bool:
        """Create an API key if none exists, atomically across nodes; return whether it was created.

        Parameters
        ----------
        keep
            Callback that receives the key before the transaction commits.
        """
        with self.database.write() as session:
            advisory_xact_lock(session, FIRST_LOCK)
            if self._fixed is not None or any(self._is_valid(row) for row in session.scalars(select(ApiKeyRow))):
                return False
            keep(self._create(session, name, scopes, None))
        return True

    def _create(self, session: Session, name: str, scopes: Iterable[Scope], lifetime: timedelta | None) -> str:
        if not 1 <= len(name) <= LONGEST_NAME:
            raise InvalidInput("name", f"{len(name)} characters", f"1 to {LONGEST_NAME}")
        identifier, secret = secrets.token_hex(6), secrets.token_urlsafe(32)
        now = self.clock()
        row = ApiKeyRow(
            id=identifier,
            name=name,
            hash=_hash(secret),
            scopes=sorted(str(scope) for scope in scopes),
            created=now,
            expires=None if lifetime is None else now + lifetime,
        )
        session.add(row)
        return f"{PREFIX}_{identifier}_{secret}"

    def any_exists(self) -> bool:
        """Return whether any valid API key exists."""
        return self._fixed is not None or any(self._is_valid(row) for row in self.list())

    def list(self) -> list[ApiKeyRow]:
        """Return the rows of all API keys, oldest first; they contain no secrets."""
        with self.database.read() as session:
            return list(session.scalars(select(ApiKeyRow).order_by(ApiKeyRow.sequence)))

    def revoke(self, identifier: str) -> None:
        """Revoke an API key at once; raises :class:`NotFound`."""
        with self.database.write() as session:
            row = session.scalars(select(ApiKeyRow).where(ApiKeyRow.id == identifier)).one_or_none()
            if row is None:
                raise NotFound("key", identifier)
            row.revoked = row.revoked or self.clock()

    def check(self, key: str) -> Principal:
        """Authenticate an API key and return its principal.

        Raises
        ------
        Unauthorized
            When it is unknown, revoked or expired; the answer does not say which.
        """
        if self._is_fixed(key):
            return _SETTINGS
        with self.database.read() as session:
            row = session.scalars(select(ApiKeyRow).where(ApiKeyRow.id == _identifier(key))).one_or_none()
        return self._prove(key, row)

    def refresh_cache(self) -> None:
        """Reload the cache of API keys from the database, for :meth:`check_cached`."""
        self._remembered = {row.id: row for row in self.list()}

    def check_cached(self, key: str) -> Principal | None:
        """Authenticate an API key from the cache; return ``None`` if it is not cached or not valid."""
        if self._is_fixed(key):
            return _SETTINGS
        with suppress(Unauthorized):
            return self._prove(key, self._remembered.get(_identifier(key)))
        return None

    def _is_fixed(self, key: str) -> bool:
        return self._fixed is not None and hmac.compare_digest(_hash(key), self._fixed)

    def _prove(self, key: str, row: ApiKeyRow | None) -> Principal:
        prefix, _, rest = key.partition("_")
        proven = hmac.compare_digest(_hash(rest.partition("_")[2]), row.hash if row else _hash(""))
        if prefix != PREFIX or row is None or not proven or not self._is_valid(row):
            raise Unauthorized("the key is unknown, revoked or expired")
        return _principal_of(row)

    def key_id(self, principal: Principal) -> str | None:
        """Return the identifier of a principal's API key; ``None`` for a principal without a key."""
        return self._fixed if principal is _SETTINGS else principal.key_id

    def principal_of_key(self, issuer: str, *, from_memory: bool = False) -> Principal:
        """Return the principal of an API key's identifier, with ``from_memory`` without querying the database.

        Raises
        ------
        Unauthorized
            When it is revoked or expired, or the settings name another one by now.
        """
        if self._fixed is not None and hmac.compare_digest(issuer, self._fixed):
            return _SETTINGS
        row = self._remembered.get(issuer)
        if not from_memory:
            with self.database.read() as session:
                row = session.scalars(select(ApiKeyRow).where(ApiKeyRow.id == issuer)).one_or_none()
        if row is None or not self._is_valid(row):
            raise Unauthorized("the key of this session is revoked or expired")
        return _principal_of(row)

    def is_revoked(self, principal: Principal) -> bool:
        """Return whether a principal's key is revoked or expired, according to the cache."""
        row = self._remembered.get(principal.key_id or "")
        return row is not None and not self._is_valid(row)

    def _is_valid(self, row: ApiKeyRow) -> bool:
        return row.revoked is None and (row.expires is None or row.expires > self.clock())


def _principal_of(row: ApiKeyRow) -> Principal:
    return Principal(f"key {row.name} ({row.id})", frozenset(Scope(scope) for scope in row.scopes), row.id)


def _identifier(key: str) -> str:
    return key.partition("_")[2].partition("_")[0][:40]


def _hash(secret: str) -> str:
    return hashlib.sha256(secret.encode()).hexdigest()
