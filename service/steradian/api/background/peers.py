"""Peer nodes: registry of scanner nodes and forwarding of requests to them.

A request that another node must answer is forwarded to it unchanged. The nodes authenticate to each other with the
shared secret in the settings; the first node authenticates the caller and forwards the caller's name and scopes.
"""

from __future__ import annotations

import hmac
import json
import socket
import threading
from collections import defaultdict
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass
from http import HTTPStatus
from http.client import HTTPConnection, HTTPException, HTTPResponse, HTTPSConnection
from typing import Final
from urllib.parse import urlsplit

from anyio import CapacityLimiter, fail_after, to_thread
from fastapi import Request, Response
from starlette.datastructures import Headers
from starlette.responses import StreamingResponse

from steradian.api.http.urls import HEADER, prefix
from steradian.core.exceptions import SteradianError
from steradian.core.settings import Settings
from steradian.security.keys import Principal, Scope, Unauthorized
from steradian.storage.db.tables import ScannerRow
from steradian.storage.repositories.scanner_lease_and_stop import ScannerRepository

SECRET, ON_BEHALF_HEADER = "Steradian-Node", "Steradian-Principal"
STOP_ID_HEADER: Final = "Steradian-Errand"
"""Names a press of the stop, which is brought again until there is an answer."""
FORWARDED_HEADERS: Final = (
    *("accept", "content-type", "if-match", "if-none-match", "if-range", "range", "scanner-lease"),
    "want-repr-digest",
)
"""Headers of a request that the other node needs to answer it, as often as they stand in it."""
HOP_BY_HOP_HEADERS: Final = frozenset({"connection", "date", "keep-alive", "server", "transfer-encoding"})
"""Headers of an answer that are of one connection alone."""
CONNECT, PATIENCE = 3.0, 20.0
"""Seconds for which another node's connection, and a word of it, is waited for."""
AT_ONCE: Final = 10
"""Requests that are sent on to a node at a time: one that hangs holds up neither this node nor others' scanners."""
PIECE: Final = 2**18


class NodeUnavailable(SteradianError):
    """Error: the node that serves the requested resource does not answer."""

    code = "node-unavailable"


class ForwardToPeer(Exception):
    """Control-flow exception of a handler: the request is forwarded to the scanner's node."""

    def __init__(self, scanner_id: str) -> None:
        self.scanner_id = scanner_id
        super().__init__(f"the node of {scanner_id} answers this")


@dataclass(frozen=True)
class PeerRequest:
    """Request to another node on behalf of a principal: method, path with query, body, headers."""

    method: str
    target: str
    who: Principal
    body: bytes = b""
    headers: tuple[tuple[str, str], ...] = ()

    @classmethod
    async def from_request(cls, request: Request) -> PeerRequest:
        """Build the copy of an incoming request that is forwarded to another node."""
        query = request.scope["query_string"].decode("latin-1")
        target = request.scope["raw_path"].decode("latin-1") + (f"?{query}" if query else "")
        headers = [(name, value) for name, value in request.headers.items() if name in FORWARDED_HEADERS]
        if below := prefix():
            headers.append((HEADER, below))
        headers.append(("x-request-id", str(request.scope["state"]["request_id"])))
        return cls(request.method, target, request.state.principal, await request.body(), tuple(headers))


class PeerRegistry:
    """Registry of scanner nodes, cached from the database, and HTTP client of these nodes.

    Parameters
    ----------
    settings
        Settings with this node's scanner and the nodes' shared secret.
    scanners
        Repository of the scanners with the addresses of their nodes.
    """

    def __init__(self, settings: Settings, scanners: ScannerRepository) -> None:
        self._secret, self._scanners = settings.node_secret, scanners
        self._own = settings.scanner_id if settings.has_scanner else None
        self._is_all, self._is_simulated = settings.role == "service", settings.simulated
        self._rows: Mapping[str, ScannerRow] = {}
        self._threads: defaultdict[str, CapacityLimiter] = defaultdict(lambda: CapacityLimiter(AT_ONCE))

    def refresh(self) -> None:
        """Reload the cached registry from the database."""
        self._rows = {row.id: row for row in self._scanners.rows()}

    def contains(self, scanner_id: str) -> bool:
        """Return whether a scanner exists, according to the cached registry."""
        return scanner_id == self._own or scanner_id in self._rows

    def is_local(self, scanner_id: str | None) -> bool:
        """Return whether a scanner belongs to this node."""
        return scanner_id is not None and scanner_id == self._own

    def is_remote(self, scanner_id: str | None) -> bool:
        """Return whether a scanner belongs to another node; a decommissioned scanner belongs to none."""
        return not self._is_all and scanner_id != self._own and scanner_id in self._rows

    def follows(self, scanner_id: str) -> bool:
        """Return whether a scanner belongs to another node that has workers for live reconstructions of its scans."""
        row = self._rows.get(scanner_id)  # once: they are replaced meanwhile
        return row is not None and row.follows and self.is_remote(scanner_id)

    @property
    def is_registered(self) -> bool:
        """Whether this node's scanner is registered; a person may have decommissioned it by mistake."""
        return self._own is None or self._own in self._rows

    @property
    def scanners(self) -> list[str]:
        """Names of all scanners in the cached registry."""
        return sorted({*self._rows, *([self._own] if self._own is not None else [])})

    @property
    def are_simulated(self) -> bool:
        """Whether all scanners of the service are simulated."""
        return self._is_simulated if self._is_all else all(row.simulated for row in self._rows.values())

    def is_released(self, scanner_id: str, since: int | None) -> bool:
        """Return whether the relay of a stop can end: scanner decommissioned, or recorded stop released."""
        row = self._rows.get(scanner_id)
        return row is None or (since is not None and row.revision > since and row.stopped_at is None)

    def send(self, scanner_id: str, question: PeerRequest, seconds: float = PATIENCE) -> HTTPResponse:
        """Send a request to a scanner's node and return the open response, which the caller reads and closes.

        Parameters
        ----------
        seconds
            Timeout of each read of the response.

        Raises
        ------
        NodeUnavailable
            When the node does not answer, or its address is unknown.
        """
        with self._reached(scanner_id, seconds) as connection:
            return self._put(connection, question)

    def request_json(self, scanner_id: str, question: PeerRequest, seconds: float) -> tuple[int, bytes]:
        """Send a request to a scanner's node and return status and body within ``seconds``; raises as :meth:`send`."""
        with self._reached(scanner_id, seconds) as connection:
            cut = threading.Timer(seconds, _cut, [connection.sock])
            cut.daemon = True
            cut.start()
            try:
                with self._put(connection, question) as answer:
                    return answer.status, answer.read()
            finally:
                cut.cancel()

    @contextmanager
    def _reached(self, scanner_id: str, seconds: float) -> Iterator[HTTPConnection]:
        """Open a connection to a scanner's node; its errors are converted to :class:`NodeUnavailable`."""
        row = self._rows.get(scanner_id)
        address = None if row is None else row.address
        if address is None or self._secret is None:
            raise NodeUnavailable(f"where the node of {scanner_id} is, is not known")
        parts = urlsplit(address)
        kind = HTTPSConnection if parts.scheme == "https" else HTTPConnection
        connection = kind(parts.hostname or "", parts.port, timeout=min(CONNECT, seconds))
        try:
            connection.connect()
            connection.sock.settimeout(seconds)
            yield connection
        except (OSError, HTTPException) as error:
            connection.close()
            raise NodeUnavailable(f"the node of {scanner_id} does not answer: {error}") from error

    def _put(self, connection: HTTPConnection, question: PeerRequest) -> HTTPResponse:
        connection.putrequest(question.method, question.target)
        proof = ((SECRET, self._secret or ""), (ON_BEHALF_HEADER, _written(question.who)), ("Connection", "close"))
        for name, value in (*question.headers, *proof):
            connection.putheader(name, value)
        if question.body or question.method != "GET":
            connection.putheader("Content-Length", str(len(question.body)))
        connection.endheaders(question.body or None)
        return connection.getresponse()

    @staticmethod
    def reject_forwarding_loop(request: Request, scanner_id: str) -> None:
        """Reject a request that another node has forwarded already, because the registered address is wrong.

        Raises
        ------
        NodeUnavailable
            When another node has forwarded the request.
        """
        if is_forwarded(request):
            raise NodeUnavailable(f"the address that is noted for the node of {scanner_id} is another node's")

    async def forward(self, request: Request, scanner_id: str) -> Response:
        """Forward a request to a scanner's node and return the response; raises :class:`NodeUnavailable`."""
        self.reject_forwarding_loop(request, scanner_id)
        question, limiter = await PeerRequest.from_request(request), self._threads[scanner_id]
        async with _place(limiter, scanner_id):
            answer = await to_thread.run_sync(self.send, scanner_id, question, limiter=CapacityLimiter(1))
        if answer.status == HTTPStatus.UNAUTHORIZED:  # this node, and not who asks
            answer.close()
            raise NodeUnavailable(f"the node of {scanner_id} has another STERADIAN_NODE_SECRET than this one")
        if answer.length is not None and answer.length <= PIECE:
            try:
                with answer:
                    body = await to_thread.run_sync(answer.read, limiter=limiter)
            except (OSError, HTTPException) as error:
                raise NodeUnavailable(f"the node of {scanner_id} fell silent: {error}") from error
            return _as_it_came(answer, Response(body, answer.status))
        return _as_it_came(answer, StreamingResponse(_pieces(answer, limiter), answer.status))


def is_forwarded(request: Request) -> bool:
    """Return whether another node forwarded the request."""
    return getattr(request.state, "forwarded", False)


def principal_of(headers: Headers, secret: str | None) -> Principal | None:
    """Return the principal on whose behalf another node sends a request; ``None`` without one.

    Raises
    ------
    Unauthorized
        When the secret is not that of this service's nodes.
    """
    given = headers.get(SECRET)
    if given is None:
        return None
    if secret is None or not hmac.compare_digest(given.encode("latin-1"), secret.encode()):
        raise Unauthorized("that is not the secret of this service's nodes")
    said = json.loads(headers[ON_BEHALF_HEADER])
    return Principal(said["name"], frozenset(map(Scope, said["scopes"])), said["key_id"])


def _as_it_came(answer: HTTPResponse, passed_back: Response) -> Response:
    """Copy the headers of a node's response, repeated ones included, to the forwarded response."""
    said = ((name.lower(), value) for name, value in answer.getheaders())
    kept = ((name, value) for name, value in said if name not in HOP_BY_HOP_HEADERS)
    passed_back.raw_headers = [(name.encode("latin-1"), value.encode("latin-1")) for name, value in kept]
    return passed_back


def _cut(connection: socket.socket) -> None:
    with suppress(OSError):  # it has just ended
        connection.shutdown(socket.SHUT_RDWR)


@asynccontextmanager
async def _place(limiter: CapacityLimiter, scanner_id: str) -> AsyncIterator[None]:
    """Acquire one of the slots for concurrent requests to a node; raises :class:`NodeUnavailable` after a timeout."""
    who = object()
    try:
        with fail_after(PATIENCE):
            await limiter.acquire_on_behalf_of(who)
    except TimeoutError:
        raise NodeUnavailable(
            f"the node of {scanner_id} is slow: {AT_ONCE} other requests wait for its answer"
        ) from None
    try:
        yield
    finally:
        limiter.release_on_behalf_of(who)


async def _pieces(answer: HTTPResponse, limiter: CapacityLimiter) -> AsyncIterator[bytes]:
    with answer:
        while piece := await to_thread.run_sync(answer.read, PIECE, limiter=limiter):
            yield piece


def _written(who: Principal) -> str:
    return json.dumps({"name": who.name, "scopes": sorted(who.scopes), "key_id": who.key_id})
