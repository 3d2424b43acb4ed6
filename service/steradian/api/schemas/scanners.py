"""Response schemas of scanners, leases and emergency stops."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any, Literal, Self, cast

from pydantic import BaseModel, Field

from steradian.api.http.urls import link
from steradian.storage.data_dir.emergency_latch import StopOutcome, StopPress
from steradian.storage.data_dir.scanner_status import (
    CURRENT_ELSEWHERE,
    LOOK_INTERVAL,
    LOOK_INTERVAL_ELSEWHERE,
    ScannerStatus,
)
from steradian.storage.db.tables import ScannerRow


class LeaseView(BaseModel):
    """Lease of a scanner: its holder, expiry and fencing token."""

    holder: str = Field(description="Name given by the holder")
    principal: str = Field(description="Whose key it is: the lease is of no use to others", examples=["local"])
    note: str | None
    ends: datetime
    fence: int = Field(description="Number of this lease; send it as Scanner-Lease with what needs the scanner")


Laser = Literal["off", "idle", "unconfirmed"]
Gate = Literal["open", "closed", "unknown"]
Key = Literal["on", "off", "unknown"]
LaserState = Literal["off", "armed", "on", "unknown"]
Connection = Literal["connected", "disconnected", "in-use", "unknown"]
UNANSWERED = "the scanner could not be asked: the acquisition process has not answered; use the hardware switch"


class EmergencyView(BaseModel):
    """Active emergency stop: author, reason, and confirmed state of the laser."""

    number: str = Field(description="Of this press; a release may name it", examples=["01k0000000000000000000000"])
    at: datetime
    by: str
    reason: str | None
    laser: Laser = Field(
        description="off: the scanner itself said so after the stop; idle: there is no scanner, a simulated one was"
        " never started; unconfirmed: it could not be asked, use the hardware switch"
    )
    detail: str | None = Field(
        description="The scanner's report, or the reason why it could not be asked, in one sentence",
        examples=["the scanner reports its laser off and its shutter closed"],
    )
    seconds: float | None = Field(description="From the press to that (s)", examples=[0.03])
    recorded: bool = Field(description="Whether it is recorded in the database; until then recording is retried")

    @classmethod
    def of(cls, press: StopPress, deed: StopOutcome | None, *, recorded: bool) -> Self:
        """Return the view of an emergency stop and its outcome."""
        return cls(
            number=press.number,
            at=datetime.fromisoformat(press.at),
            by=press.who,
            reason=press.reason,
            laser=cast(Laser, deed.laser) if deed else "unconfirmed",
            detail=(deed.detail or None) if deed else UNANSWERED,
            seconds=deed.seconds if deed else None,
            recorded=recorded,
        )

    @classmethod
    def of_row(cls, row: ScannerRow) -> Self | None:
        """Return the active stop of another node's scanner from its database row; ``None`` without a stop."""
        if row.stopped_at is None:
            return None
        return cls(
            number=row.stop_number or "",
            at=row.stopped_at,
            by=row.stopped_by or "",
            reason=row.stop_reason,
            laser=cast(Laser, row.stop_laser or "unconfirmed"),
            detail=(row.stop_detail or None) if row.stop_laser else UNANSWERED,
            seconds=row.stop_seconds,
            recorded=True,
        )


class EmergencyAnswer(BaseModel):
    """Response to pressing the emergency stop."""

    id: str = Field(description="The scanner", examples=["scanner-0"])
    emergency_stop: EmergencyView
    links: dict[str, str] = Field(examples=[{"scanner": "/api/v1/…"}])


class FaultView(BaseModel):
    """A latched fault of a scanner."""

    code: int = Field(description="Number of the scanner's protocol", examples=[1])
    name: str = Field(examples=["interlock-opened"])
    title: str = Field(description="What has happened", examples=["the interlock opened"])
    remedy: str = Field(description="What to do", examples=["close the enclosure, then clear the fault"])
    clearable: bool = Field(description="Whether its cause is gone, so that it can be cleared")


class ScannerView(BaseModel):
    """Scanner: connection, activity of this service, and the device's reported state."""

    id: str
    simulated: bool
    model: str | None = Field(description="As the scanner says; null: it was not heard yet")
    serial: str | None = Field(description="Serial number, likewise")
    connection: Connection = Field(
        description="in-use: another program holds the port, see holder; unknown: nobody looks", examples=["connected"]
    )
    holder: str | None = Field(description="Other program that holds the port", examples=["steradian (process 4242)"])
    state: str = Field(
        description="idle, scanning (also where another program scans), paused or fault", examples=["idle"]
    )
    laser: LaserState = Field(
        description="As the scanner says; armed also where it may fire at any moment; unknown is not off"
    )
    shutter: Gate = Field(description="Of the excitation laser, as its end switch reads")
    interlock: Gate = Field(description="As the scanner reads it")
    key: Key = Field(description="The key switch, likewise")
    fault: FaultView | None = Field(description="The latched fault, which a person clears")
    looked_at: datetime | None = Field(description="When the scanner said so; null: it was not heard")
    age: float | None = Field(
        description="How long ago that was (s): after 1 s (10 s for another node's scanner) all of it is unknown"
    )
    look_interval: float = Field(description="Maximum interval between checks (s)", examples=[LOOK_INTERVAL])
    since: datetime = Field(description="When connection or state changed last")
    last_error: str | None = Field(description="Why the scanner cannot be talked to now; null: all is well")
    lease: LeaseView | None
    emergency_stop: EmergencyView | None
    links: dict[str, str] = Field(examples=[{"self": "/api/v1/…"}])

    @classmethod
    def of(
        cls, row: ScannerRow, status: ScannerStatus | None, now: datetime, *, held: bool, stop: EmergencyView | None
    ) -> Self:
        """Return the view of a scanner from its row, reported status, lease and emergency stop.

        Parameters
        ----------
        row
            Database row of the scanner.
        status
            Status that this node's scanner reports; ``None`` for another node's.
        now
            The present time, UTC.
        held
            Whether the scanner is leased.
        stop
            The active emergency stop.
        """
        here = link(f"/scanners/{row.id}")
        lease = None
        if held and row.lease_ends is not None:
            about: dict[str, Any] = {"holder": row.holder, "principal": row.held_by, "note": row.note}
            lease = LeaseView(**about, ends=row.lease_ends, fence=row.fence)
        age = status.age() if status is not None else _age(row, now)
        seen = status if status is not None else _status(row, age)
        return cls(
            id=row.id,
            simulated=row.simulated,
            model=seen.model or row.model,
            serial=seen.serial or row.serial,
            connection=cast(Connection, seen.connection),
            holder=seen.holder,
            state=_state(row, seen),
            laser=cast(LaserState, seen.laser),
            shutter=cast(Gate, seen.shutter),
            interlock=cast(Gate, seen.interlock),
            key=cast(Key, seen.key),
            fault=FaultView(**seen.fault) if seen.fault else None,
            looked_at=None if age is None else now - timedelta(seconds=age),
            age=age,
            look_interval=LOOK_INTERVAL if status is not None else LOOK_INTERVAL_ELSEWHERE,
            since=row.since,
            last_error=seen.error,
            lease=lease,
            emergency_stop=stop,
            links={
                "self": here,
                "lease": f"{here}/lease",
                "emergency-stop": f"{here}/emergency-stop",
                "clear-fault": f"{here}/clear-fault",
            },
        )


def _age(row: ScannerRow, now: datetime) -> float | None:
    if row.looked_at is None:
        return None
    return max((now - row.looked_at.astimezone(UTC)).total_seconds(), 0.0)


def _status(row: ScannerRow, age: float | None) -> ScannerStatus:
    """Return the status of another node's scanner as recorded in the database; unknown if outdated."""
    if age is None or age > CURRENT_ELSEWHERE:
        return ScannerStatus(error=row.last_error)
    return ScannerStatus(
        connection=row.connection,
        laser=row.laser,
        shutter=row.shutter,
        interlock=row.interlock,
        key=row.key_switch,
        fault=row.fault,
        error=row.last_error,
        holder=row.port_holder,
    )


def _state(row: ScannerRow, seen: ScannerStatus) -> str:
    """Return the scanner's state in the database, unless the device reports a more specific one."""
    if seen.laser in {"armed", "on"}:
        return "scanning"
    return "fault" if seen.fault and row.state == "idle" else row.state
