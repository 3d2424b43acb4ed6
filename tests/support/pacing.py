"""A scan that keeps in step with who looks at it; here so that the process that scans can import it."""

from __future__ import annotations

from multiprocessing.sharedctypes import Synchronized

from steradian.scans.acquisition.session_control import Command, SessionControl


class InStep(SessionControl):
    """Pauses a scan at each 400 A-lines until an image of them was seen, however busy the machine."""

    def __init__(self, seen: Synchronized[int]) -> None:
        super().__init__()
        self._seen, self._stored = seen, 0

    def progress(self, done: int, total: int) -> None:
        self._stored = done

    def command(self) -> Command:
        return Command.PAUSE if self._seen.value < self._stored // 400 else Command.RUN
