"""Relay of emergency stops to a scanner's node, repeated until acknowledged and also recorded in the database."""

from __future__ import annotations

import json
import logging
import threading
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Final

from ulid import ULID

from steradian.api.background.local_emergency_stop import wait_until
from steradian.api.background.peers import STOP_ID_HEADER, NodeUnavailable, PeerRegistry, PeerRequest
from steradian.api.http.urls import link
from steradian.api.schemas.resources import BASE
from steradian.api.schemas.scanners import EmergencyAnswer, EmergencyView
from steradian.security.keys import Principal
from steradian.storage.repositories.scanner_lease_and_stop import ScannerRepository

ANSWER_TIMEOUT: Final = 3.0
"""Seconds for which the other node's answer is waited for: it waits up to two itself for what its scanner says."""
PERSIST_AFTER: Final = 0.5
"""Seconds after which a press that has not been answered is written into the database, too."""
RETRY_INTERVAL: Final = 0.25
"""Seconds between two errands."""
MAX_PENDING: Final = 8
"""Presses of one scanner that are carried at a time; an older one gives way, for the later ones stop it as well."""
_log = logging.getLogger(__name__)


@dataclass
class _PendingStop:
    scanner_id: str
    number: str
    question: PeerRequest
    reason: str | None
    answer: EmergencyAnswer | None = None
    recorded: int | None = None
    """Revision of the scanner's row in which the press stands."""


class EmergencyStopRelay:
    """Relay that delivers emergency stops to other nodes at least once; unanswered stops are also recorded.

    The relay ends without an acknowledgement when the scanner is decommissioned, or when the recorded stop is
    released. This node assigns the number of the stop, so that the caller can release it.

    Parameters
    ----------
    nodes
        Registry of the scanners' nodes.
    scanner
        Repository in which unanswered stops are recorded.
    """

    def __init__(self, nodes: PeerRegistry, scanner: ScannerRepository) -> None:
        self._nodes, self._scanner = nodes, scanner
        self._over = threading.Event()
        self._carried: dict[str, tuple[_PendingStop, ...]] = {}

    def close(self) -> None:
        """Stop the relay of pending emergency stops."""
        self._over.set()

    async def press(self, scanner_id: str, who: Principal, reason: str | None) -> EmergencyAnswer:
        """Relay a stop to a remote scanner's node and return its response, or an unconfirmed one after a timeout."""
        path, body = f"{BASE}/scanners/{scanner_id}/emergency-stop", json.dumps({"reason": reason}).encode()
        number = str(ULID())
        headers = (("Content-Type", "application/json"), ("Accept", "application/json"), (STOP_ID_HEADER, number))
        errand = _PendingStop(scanner_id, number, PeerRequest("POST", path, who, body, headers), reason)
        self._carried[scanner_id] = (*self._carried.get(scanner_id, ()), errand)[-MAX_PENDING:]
        threading.Thread(target=self._deliver, args=(errand,), name="stop-courier", daemon=True).start()
        await wait_until(lambda: errand.answer is not None, PERSIST_AFTER)
        if errand.answer is None:
            threading.Thread(target=self._persist, args=(errand,), name="stop-record", daemon=True).start()
            await wait_until(lambda: errand.answer is not None, ANSWER_TIMEOUT - PERSIST_AFTER)
        return errand.answer or _unconfirmed(errand)

    def _is_pending(self, errand: _PendingStop) -> bool:
        pending = errand.answer is None and not self._over.is_set()
        is_over = self._nodes.is_released(errand.scanner_id, errand.recorded)
        return pending and not is_over and any(each is errand for each in self._carried[errand.scanner_id])

    def _deliver(self, errand: _PendingStop) -> None:
        told = ""
        while True:
            try:
                status, said = self._nodes.request_json(errand.scanner_id, errand.question, ANSWER_TIMEOUT)
                if status == 202:
                    errand.answer = EmergencyAnswer.model_validate_json(said)
                    return
                why = f"its node refuses it: {said[:500]!r}"
            except (NodeUnavailable, ValueError) as error:
                why = str(error)
            if why != told:
                _log.error("the emergency stop does not reach %s yet: %s", errand.scanner_id, why)
            told = why
            self._over.wait(RETRY_INTERVAL)
            if not self._is_pending(errand):
                return

    def _persist(self, errand: _PendingStop) -> None:
        scanner, who = self._scanner.of(errand.scanner_id), errand.question.who.name
        while self._is_pending(errand):
            try:
                errand.recorded = scanner.stop(who, errand.reason, errand.number, carried=True).revision
            except Exception as error:  # whatever it was, it is tried again
                _log.warning("the emergency stop cannot be written into the database: %s", error)
                self._over.wait(4 * RETRY_INTERVAL)
                continue
            return


def _unconfirmed(errand: _PendingStop) -> EmergencyAnswer:
    shown = EmergencyView(
        number=errand.number,
        at=datetime.now(UTC),
        by=errand.question.who.name,
        reason=errand.reason,
        laser="unconfirmed",
        detail=f"the scanner could not be asked: the node of {errand.scanner_id} has not answered within "
        f"{ANSWER_TIMEOUT:g} s; use the hardware switch",
        seconds=None,
        recorded=errand.recorded is not None,
    )
    here = link(f"/scanners/{errand.scanner_id}")
    return EmergencyAnswer(id=errand.scanner_id, emergency_stop=shown, links={"scanner": here})
