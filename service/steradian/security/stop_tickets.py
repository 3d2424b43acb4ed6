"""Stop tickets: signed credentials that press the emergency stop even after the browser session has expired.

A ticket names its principal and the time at which it ends, signed with HMAC-SHA256. It is checked without a database,
so a page can press the stop while there is none. It allows the emergency stop and nothing else.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import os
import secrets
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Final

from steradian.security.keys import Principal, Unauthorized
from steradian.storage.db.timestamps_and_ids import Clock, utc_now

LIFETIME: Final = timedelta(days=7)
"""How long a ticket is valid; a page that is open and signed in gets new ones."""
SUFFIX: Final = " (stop ticket)"
"""What follows the principal's name in the record of a press."""
LONGEST: Final = 1000
"""Characters of a ticket; a longer one is refused unread."""
_LONGEST_NAME: Final = 120
"""Characters of the column that records who pressed the stop."""
_SECRET_BYTES: Final = 32
_WORTHLESS = "the stop ticket is unknown or too old; sign in again"


class StopTickets:
    """Issuer and verifier of stop tickets, signed with HMAC.

    Parameters
    ----------
    secret
        The key of the signatures; see :func:`stored_secret` and :func:`shared_secret`.
    """

    def __init__(self, secret: bytes, clock: Clock = utc_now) -> None:
        self._secret, self._clock = secret, clock

    def issue(self, principal: Principal) -> str:
        """Return a signed stop ticket for an authenticated principal, valid for :data:`LIFETIME`."""
        ends = self._clock() + LIFETIME
        said = json.dumps([principal.name, int(ends.timestamp())], ensure_ascii=False).encode()
        return f"{_text(said)}.{_text(self._sign(said))}"

    def check(self, ticket: str) -> Principal:
        """Verify a stop ticket and return its principal, with :data:`SUFFIX` after the name and without any scope.

        Raises
        ------
        Unauthorized
            When the ticket was not made with this secret, or has ended.
        """
        said, signature = _parts(ticket)
        if not hmac.compare_digest(signature, self._sign(said)):
            raise Unauthorized(_WORTHLESS)
        name, ends = json.loads(said)
        if datetime.fromtimestamp(ends, UTC) <= self._clock():
            raise Unauthorized(_WORTHLESS)
        return Principal(_shortened(name), frozenset())

    def _sign(self, said: bytes) -> bytes:
        return hmac.digest(self._secret, said, hashlib.sha256)


def shared_secret(node_secret: str) -> bytes:
    """Derive the signing key that all nodes share from ``STERADIAN_NODE_SECRET``."""
    return hmac.digest(node_secret.encode(), b"steradian stop ticket", hashlib.sha256)


def stored_secret(path: Path) -> bytes:
    """Read the signing key from a file, created with mode 600 if missing or damaged.

    Of several processes that make it at once all read the same one.
    """
    with suppress(FileNotFoundError):
        found = path.read_bytes()
        if len(found) == _SECRET_BYTES:
            return found
        path.unlink(missing_ok=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    with NamedTemporaryFile(dir=path.parent, prefix=f"{path.name}.") as draft:  # made with mode 600
        draft.write(secrets.token_bytes(_SECRET_BYTES))
        draft.flush()
        os.fsync(draft.fileno())
        with suppress(FileExistsError):
            os.link(draft.name, path)
    return path.read_bytes()


def _shortened(name: str) -> str:
    room = _LONGEST_NAME - len(SUFFIX)
    return (name if len(name) <= room else f"{name[: room - 1]}…") + SUFFIX


def _text(data: bytes) -> str:
    return base64.urlsafe_b64encode(data).rstrip(b"=").decode()


def _data(text: str) -> bytes:
    return base64.urlsafe_b64decode(f"{text}==")


def _parts(ticket: str) -> tuple[bytes, bytes]:
    """Decode a stop ticket to payload and signature; raises :class:`Unauthorized` for other text."""
    try:
        if len(ticket) > LONGEST:
            raise ValueError("too long")
        said, signature = map(_data, ticket.split("."))
    except ValueError as error:
        raise Unauthorized(_WORTHLESS) from error
    return said, signature
