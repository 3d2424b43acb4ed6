"""Decommissioning of a scanner, after a check that its node is down; ends its unfinished scans."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from http import HTTPStatus

from fastapi import Request

from steradian.api.background.peers import NodeUnavailable, PeerRequest
from steradian.api.schemas.resources import BASE
from steradian.api.services import ServiceContainer
from steradian.core.settings import Settings
from steradian.runtime.singleton_locks import lock_of_scanner
from steradian.scans.summary import scan_summary
from steradian.security.keys import Principal
from steradian.storage.db.advisory_locks import LockState
from steradian.storage.db.tables import ScanRow
from steradian.storage.repositories.deletion import InUse
from steradian.storage.state_machines import ScanState, is_terminal

ANSWER_TIMEOUT = 3.0
"""Seconds for which the node's answer is waited for."""


def decommission_scanner(
    services: ServiceContainer, request: Request, who: Principal, scanner_id: str, reason: str | None, *, abandon: bool
) -> None:
    """Decommission a scanner, after a check that its node is down.

    Parameters
    ----------
    abandon
        Whether to end the scanner's unfinished scans.

    Raises
    ------
    NotFound
        When there is no such scanner.
    InUse
        When the scanner's node runs, or a scan is unfinished.
    NodeUnavailable
        When the database does not report whether the node runs.
    """
    scanner = services.scanner.of(scanner_id)
    scanner.get(scanner_id)
    if services.nodes.is_local(scanner_id):
        raise InUse(f"{scanner_id} cannot be retired while its node, which is this one, runs")
    services.nodes.reject_forwarding_loop(request, scanner_id)
    with _hold_node_lock(services.settings, scanner_id):
        _require_no_response(services, scanner_id, who)
        for scan in services.scans.of(scanner_id).unfinished() if abandon else ():
            _abandon_scan(services, scan, who.name)
        scanner.retire(who.name, reason)


@contextmanager
def _hold_node_lock(settings: Settings, scanner_id: str) -> Iterator[None]:
    """Hold the advisory lock of a scanner's node, so that the node cannot start before the block ends."""
    if settings.database_url is None:  # then there are no nodes
        yield
        return
    lock = lock_of_scanner(settings.database_url, scanner_id)
    try:
        hold = lock.ensure_held()
        if hold is LockState.TAKEN:
            raise InUse(f"{scanner_id} cannot be retired while its node lives: it holds the scanner's lock")
        if hold is LockState.UNREACHABLE:
            raise NodeUnavailable(f"whether the node of {scanner_id} lives, the database does not tell now")
        yield
    finally:
        lock.release()


def _require_no_response(services: ServiceContainer, scanner_id: str, who: Principal) -> None:
    """Raise :class:`InUse` if the scanner's node still answers; it may have lost only the database."""
    question = PeerRequest("DELETE", f"{BASE}/scanners/{scanner_id}", who)
    with suppress(NodeUnavailable):
        if services.nodes.request_json(scanner_id, question, ANSWER_TIMEOUT)[0] == HTTPStatus.CONFLICT:
            raise InUse(f"{scanner_id} cannot be retired while its node lives, which answers")


def _abandon_scan(services: ServiceContainer, scan: ScanRow, who: str) -> None:
    """Move an unfinished scan of a decommissioned scanner to a terminal state."""
    why, end = "its scanner is retired", services.scans.transition
    if scan.state is ScanState.QUEUED:
        end(scan.id, ScanState.ABORTED, why=why, who=who)
        return
    if scan.state is not ScanState.INTERRUPTED and not is_terminal(scan.state):
        end(scan.id, ScanState.INTERRUPTED, why=why, who=who)
    figures = scan_summary(services.arrays, services.data.scan_file(scan.id), scan.id)
    end(scan.id, ScanState.PARTIAL, why=why, who=who, summary=figures)
