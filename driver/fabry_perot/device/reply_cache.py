"""Reply cache for at-most-once request execution."""

from __future__ import annotations

from collections import OrderedDict


class ReplyCache:
    """The last few replies of a session, by request id.

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
        """Forget everything: a new session."""
        self._replies.clear()
        self._newest = None

    def find(self, request: int) -> bytes | None:
        """Return the stored reply to ``request``, if it is still kept."""
        return self._replies.get(request)

    def stale(self, request: int) -> bool:
        """Return whether ``request`` is not newer than one already carried out; ids count modulo 2¹⁶."""
        return self._newest is not None and not 0 < (request - self._newest) & 0xFFFF < 0x8000

    def store(self, request: int, reply: bytes) -> None:
        """Keep ``reply``."""
        if not self.stale(request):
            self._newest = request
        self._replies[request] = reply
        while len(self._replies) > self._size:
            self._replies.popitem(last=False)
