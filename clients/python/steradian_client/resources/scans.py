"""Collection of scans: creation, control, and reading of A-lines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from steradian_client import routes
from steradian_client.arrays import RAW, parse_array
from steradian_client.downloads import Report, download
from steradian_client.models import Coverage, Lease, Scan, Shots, Signals
from steradian_client.resources.base import AwaitableResource, drop_none
from steradian_client.resources.scanners import lease_header
from steradian_client.sync_async import Mode, dual_method

if TYPE_CHECKING:
    from steradian_client.arrays import Array


class Scans(AwaitableResource[Mode, Scan]):
    """Collection of scans: runs of plans on a scanner."""

    _kind, _read, _list, _delete = Scan, routes.READ_SCAN, routes.LIST_SCANS, routes.DELETE_SCAN
    _event = "scan"

    @dual_method
    async def create(
        self,
        plan_id: str,
        *,
        labels: Mapping[str, str] | None = None,
        lease: Lease | int | None = None,
        completes: str | None = None,
        scanner_id: str | None = None,
        idempotency_key: str | None = None,
    ) -> Scan:
        """Queue a run of a plan as a scan.

        Parameters
        ----------
        labels
            Texts of your own.
        lease
            The scanner's, while somebody holds it.
        completes
            A scan of the same plan that is over, whose missing points are to be measured: the new one begins with
            its A-lines.
        scanner_id
            Scanner that runs it, if there are several.
        idempotency_key
            Repeating the call with the same key finds the scan that the first call made; ``None`` makes a new key.
        """
        body = drop_none(plan_id=plan_id, labels=labels, completes=completes, scanner_id=scanner_id)
        headers = lease_header(lease)
        return await self._session.request_model(
            Scan, routes.CREATE_SCAN, json=body, headers=headers, key=idempotency_key
        )

    @dual_method
    async def set_labels(self, scan_id: str, labels: Mapping[str, str | None]) -> Scan:
        """Set labels (key-value pairs) of a scan; ``None`` removes a label."""
        return await self._session.request_model(
            Scan, routes.CHANGE_SCAN, {"id": scan_id}, json={"labels": dict(labels)}
        )

    @dual_method
    async def pause(self, scan_id: str, reason: str | None = None) -> Scan:
        """Pause a scan, which turns the laser off."""
        return await self._wish(scan_id, "paused", reason)

    @dual_method
    async def resume(self, scan_id: str, reason: str | None = None, *, lease: Lease | int | None = None) -> Scan:
        """Resume a paused or interrupted scan.

        It is sent once, even where no service answers: the laser fires, and somebody may have stopped it meanwhile.
        """
        return await self._wish(scan_id, "running", reason, lease)

    @dual_method
    async def stop(self, scan_id: str, reason: str | None = None) -> Scan:
        """Stop a scan and keep the measured A-lines."""
        return await self._wish(scan_id, "stopped", reason)

    @dual_method
    async def abort(self, scan_id: str, reason: str | None = None) -> Scan:
        """Abort a scan permanently."""
        return await self._wish(scan_id, "aborted", reason)

    @dual_method
    async def decide_stage(
        self,
        scan_id: str,
        number: int,
        *,
        points_of_interest: Sequence[Sequence[float]] | None = None,
        proposals: Sequence[int] | None = None,
        lease: Lease | int | None = None,
    ) -> Scan:
        """Choose the points of interest of a scan's stage that is not made yet.

        Parameters
        ----------
        number
            Number of the stage, from 2.
        points_of_interest
            (P, 3) x, y and depth in metres; or else
        proposals
            Numbers of proposals in the scan's ``stages``, from 1.
        lease
            The scanner's, while somebody holds it.
        """
        body = drop_none(points_of_interest=points_of_interest, proposals=proposals)
        where = {"id": scan_id, "number": str(number)}
        return await self._session.request_model(
            Scan, routes.DECIDE_SCAN_STAGE, where, json=body, headers=lease_header(lease)
        )

    @dual_method
    async def coverage(self, scan_id: str) -> Coverage:
        """Count the measured points of a scan's mask, also while the scan runs."""
        return await self._session.request_model(Coverage, routes.READ_COVERAGE, {"id": scan_id})

    @dual_method
    async def shots(self, scan_id: str, points: str | None = None, *, since: str | None = None) -> Shots:
        """Return the metadata of each shot; ``points`` in NumPy's syntax, for example ``"0:100"``.

        With ``since``, the ``next`` of an earlier answer, only of those that have changed after it.
        """
        params = {"points": points, "since": since}
        return await self._session.request_model(Shots, routes.READ_SHOTS, {"id": scan_id}, params=params)

    @dual_method
    async def signals(self, scan_id: str, frame: int = 0) -> Signals:
        """Return signal statistics of the measured A-lines of a frame: codes, noise, baseline, bad A-lines."""
        return await self._session.request_model(Signals, routes.READ_SIGNALS, {"id": scan_id}, params={"frame": frame})

    @dual_method
    async def alines(self, scan_id: str, slice: str | None = None) -> Array:
        """Return A-lines (points, samples) in digitiser counts; ``slice`` in NumPy's syntax, e.g. ``"0:10,::2"``."""
        params, headers = {"slice": slice}, {"Accept": RAW}
        answer = await self._session.send_with_retries(
            routes.READ_ALINES, {"id": scan_id}, params=params, headers=headers
        )
        return parse_array(answer)

    @dual_method
    async def latest_aline(self, scan_id: str) -> Array:
        """Return the most recently stored A-line (samples), in digitiser counts."""
        headers = {"Accept": RAW}
        return parse_array(
            await self._session.send_with_retries(routes.READ_LATEST_ALINE, {"id": scan_id}, headers=headers)
        )

    @dual_method
    async def save_file(self, scan_id: str, target: Path | str, *, progress: Report | None = None) -> Path:
        """Download the scan file (HDF5); an interrupted download is resumed."""
        return await download(self._session, routes.READ_SCAN_FILE, {"id": scan_id}, target, progress=progress)

    async def _wish(self, scan_id: str, state: str, reason: str | None, lease: Lease | int | None = None) -> Scan:
        route = routes.RUN_SCAN if state == "running" else routes.SET_SCAN_STATE
        body = {"state": state, "reason": reason}
        return await self._session.request_model(Scan, route, {"id": scan_id}, json=body, headers=lease_header(lease))
