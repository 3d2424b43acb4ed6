"""Client of an S3 bucket below a prefix; the only module that imports obstore."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from steradian.core.exceptions import DamagedFile, InvalidInput, StoreUnavailable

if TYPE_CHECKING:
    from obstore.store import S3Store

PART_BYTES: Final = 16 * 2**20
"""Bytes that are sent or fetched at a time."""
MAX_CONCURRENCY: Final = 4
"""Parts that are sent at a time."""
TIMEOUT: Final = timedelta(seconds=60)
"""How long a store that does not answer is asked again by who can wait."""


class S3Bucket:
    """Client of an S3 bucket below a prefix, with atomic uploads.

    The store's keys are those of the environment, as S3's programs know them (``AWS_ACCESS_KEY_ID``, …).

    Parameters
    ----------
    url
        ``s3://bucket/prefix``.
    endpoint
        Address of a store that is not Amazon's.
    patience
        How long it is asked again when it does not answer.

    Raises
    ------
    InvalidInput
        When the library is not installed.
    """

    def __init__(self, url: str, endpoint: str | None, patience: timedelta = TIMEOUT) -> None:
        try:
            import obstore
        except ImportError as error:
            raise InvalidInput("store", url, "none without obstore: pip install 'steradian[store]'") from error
        self.url, self._library = url, obstore
        self._store: S3Store = obstore.store.S3Store.from_url(
            url,
            config={} if endpoint is None else {"endpoint": endpoint},
            client_options={
                "allow_http": (endpoint or "").startswith("http://"),
                "connect_timeout": "5s",
                "read_timeout": "30s",
                "timeout": "1h",
            },
            retry_config={"max_retries": 20 if patience else 0, "retry_timeout": patience},
        )

    def size(self, key: str) -> int | None:
        """Return the size of an object in bytes; ``None`` if it does not exist."""
        with self._understood(key), suppress(FileNotFoundError):
            return self._library.head(self._store, key)["size"]
        return None

    def create(self, key: str, content: Path | bytes) -> None:
        """Upload an object, in parts if it is large; an existing small object stays unchanged.

        The store's protocol has no condition for parts that every store knows: let a key tell the content.
        """
        size = len(content) if isinstance(content, bytes) else content.stat().st_size
        mode: Any = "overwrite" if size > PART_BYTES else "create"
        with self._understood(key), suppress(self._library.exceptions.AlreadyExistsError):
            self._library.put(
                self._store, key, content, mode=mode, chunk_size=PART_BYTES, max_concurrency=MAX_CONCURRENCY
            )

    def fetch(self, key: str, target: Path) -> str:
        """Download an object to a file and return the SHA-256 of the received bytes.

        Raises
        ------
        DamagedFile
            When there is no such object.
        """
        digest = hashlib.sha256()
        with self._found(key), target.open("wb") as file:
            for piece in self._library.get(self._store, key).stream(min_chunk_size=PART_BYTES):
                digest.update(piece)
                file.write(piece)
        return digest.hexdigest()

    def range(self, key: str, first: int, count: int) -> bytes:
        """Download a byte range of an object; raises :class:`DamagedFile` if the object does not exist."""
        with self._found(key):
            return bytes(self._library.get_range(self._store, key, start=first, length=count))

    def sign(self, key: str, seconds: float) -> str:
        """Return a presigned URL of an object, valid for ``seconds`` seconds."""
        with self._understood(key):
            return self._library.sign(self._store, "GET", key, timedelta(seconds=seconds))

    def list(self) -> Iterator[tuple[str, int, datetime]]:
        """Yield key, size and modification time of each object."""
        with self._understood("the list of objects"):
            for page in self._library.list(self._store):
                yield from ((each["path"], each["size"], each["last_modified"]) for each in page)

    def delete(self, keys: Sequence[str]) -> None:
        """Delete objects; missing objects are ignored."""
        with self._understood(f"deletion of {len(keys)} objects"):
            if keys:
                self._library.delete(self._store, keys)

    @contextmanager
    def _found(self, key: str) -> Iterator[None]:
        try:
            with self._understood(key):
                yield
        except FileNotFoundError as error:
            raise DamagedFile(f"the store does not have {key} any more") from error

    @contextmanager
    def _understood(self, what: str) -> Iterator[None]:
        """Translate errors of obstore to :class:`StoreUnavailable`, without messages that may contain an access key."""
        try:
            yield
        except (FileNotFoundError, self._library.exceptions.AlreadyExistsError):
            raise
        except self._library.exceptions.BaseError as error:
            raise StoreUnavailable(f"the store {self.url} does not answer ({type(error).__name__}): {what}") from None
