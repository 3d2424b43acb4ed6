"""Reply cache for at-most-once request execution."""

from __future__ import annotations

from collections import OrderedDict


class ReplyCache:
    """Cache of the last replies of a session, by request id.

    Parameters
    ----------
    size
        Replies kept.
    """

    def __init__(self, size: int = 8) -> None:
        self._size = size
        self._replies: OrderedDict[int, bytes] = OrderedDict()
        self._newest: int | None = None

    def clear(self) -> None:
        """Delete all replies at the start of a session."""
        self._replies.clear()
        self._newest = None

    def find(self, request: int) -> bytes | None:
        """Return the cached reply to ``request``, or ``None``."""
        return self._replies.get(request)

    def stale(self, request: int) -> bool:
        """Return whether ``request`` is not newer than an executed one; ids count modulo 2¹⁶."""
        return self._newest is not None and not 0 < (request - self._newest) & 0xFFFF < 0x8000

    def store(self, request: int, reply: bytes) -> None:
        """Store the reply to a request."""
        if not self.stale(request):
            self._newest = request
        self._replies[request] = reply
        while len(self._replies) > self._size:
            self._replies.popitem(last=False)
