"""Clearing of a scanner's latched fault: request to the acquisition process, then record in the database."""

from __future__ import annotations

import threading
import time
from typing import Final

from steradian.core.exceptions import Conflict, FaultStands, ScannerUnreachable, SteradianError
from steradian.storage.data_dir.fault_requests import WITHIN, ClearAnswer, ClearFaultRequest
from steradian.storage.repositories.scanner_lease_and_stop import ScannerRepository

LOOK: Final = 0.01
_KINDS: Final[dict[str, type[SteradianError]]] = {
    kind.code: kind for kind in (Conflict, FaultStands, ScannerUnreachable)
}


class FaultClearingService:
    """Service that clears the latched fault of this node's scanner, one request at a time.

    Parameters
    ----------
    clearing
        Files through which the acquisition process receives requests and answers them.
    scanner
        Repository in which the clearing is recorded.
    """

    def __init__(self, clearing: ClearFaultRequest, scanner: ScannerRepository) -> None:
        self._clearing, self._scanner = clearing, scanner
        self._turn = threading.Lock()

    def clear(self, who: str, reason: str | None) -> None:
        """Clear the latched fault through the acquisition process, and record the name of the person.

        Without a fault nothing is recorded.

        Raises
        ------
        FaultStands
            While the cause of the fault persists.
        Conflict
            When a scan or another program uses the scanner.
        ScannerUnreachable
            When scanner or acquisition process do not answer.
        """
        with self._turn:
            answer = self._ask(who)
        if answer.code:
            raise _KINDS.get(answer.code, ScannerUnreachable)(answer.message)
        if answer.fault:
            self._scanner.note_cleared(who, answer.fault, reason)

    def _ask(self, who: str) -> ClearAnswer:
        request = self._clearing.ask(who)
        while request.is_current:
            if (answer := self._clearing.answered(request.number)) is not None:
                return answer
            time.sleep(LOOK)
        raise ScannerUnreachable(f"the acquisition process has not answered within {WITHIN:g} s")
