"""What scanners, leases and emergency stops look like in JSON."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal, Self, cast

from pydantic import BaseModel, Field

from steradian.api.views import BASE
from steradian.storage.emergency import Deed, Press
from steradian.storage.tables import ScannerRow


class LeaseView(BaseModel):
    """Who holds a scanner."""

    holder: str = Field(description="How the holder calls itself")
    principal: str = Field(description="Whose key it is: the lease is of no use to others", examples=["local"])
    note: str | None
    ends: datetime
    fence: int = Field(description="Number of this lease; send it as Scanner-Lease with what needs the scanner")


Laser = Literal["off", "idle", "unconfirmed"]
Gate = Literal["open", "closed", "unknown"]


class EmergencyView(BaseModel):
    """An emergency stop that nobody has released."""

    number: str = Field(description="Of this press; a release may name it", examples=["01k0000000000000000000000"])
    at: datetime
    by: str
    reason: str | None
    laser: Laser = Field(
        description="off: the scanner confirmed it; idle: no scan ran; unconfirmed: no answer, use the hardware switch"
    )
    seconds: float | None = Field(description="From the press to that (s)", examples=[0.03])
    recorded: bool = Field(description="Whether it stands in the database, too; until then it is tried again")

    @classmethod
    def of(cls, press: Press, deed: Deed | None, *, recorded: bool) -> Self:
        """Show a press and what was done about it."""
        return cls(
            number=press.number,
            at=datetime.fromisoformat(press.at),
            by=press.who,
            reason=press.reason,
            laser=cast(Laser, deed.laser) if deed else "unconfirmed",
            seconds=deed.seconds if deed else None,
            recorded=recorded,
        )

    @classmethod
    def of_row(cls, row: ScannerRow) -> Self | None:
        """Show the press that stands, of another node's scanner, as the database knows it."""
        if row.stopped_at is None:
            return None
        return cls(
            number=row.stop_number or "",
            at=row.stopped_at,
            by=row.stopped_by or "",
            reason=row.stop_reason,
            laser=cast(Laser, row.stop_laser or "unconfirmed"),
            seconds=row.stop_seconds,
            recorded=True,
        )


class EmergencyAnswer(BaseModel):
    """What came of pressing the emergency stop."""

    id: str = Field(description="The scanner", examples=["scanner-0"])
    emergency_stop: EmergencyView
    links: dict[str, str] = Field(examples=[{"scanner": "/api/v1/…"}])


class ScannerView(BaseModel):
    """A scanner: connection and state apart."""

    id: str
    simulated: bool
    connection: str = Field(description="unknown, connected or disconnected", examples=["connected"])
    state: str = Field(description="idle or scanning", examples=["idle"])
    interlock: Gate = Field(description="As the scanner reads it; unknown while no scan has it connected")
    key: Literal["on", "off", "unknown"] = Field(description="The key switch, likewise")
    shutter: Gate = Field(description="Of the excitation laser, likewise")
    since: datetime = Field(description="When connection or state changed last")
    last_error: str | None
    lease: LeaseView | None
    emergency_stop: EmergencyView | None
    links: dict[str, str] = Field(examples=[{"self": "/api/v1/…"}])

    @classmethod
    def of(cls, row: ScannerRow, *, held: bool, stop: EmergencyView | None) -> Self:
        """Show a row and the stop that stands."""
        here = f"{BASE}/scanners/{row.id}"
        lease = None
        if held and row.lease_ends is not None:
            about: dict[str, Any] = {"holder": row.holder, "principal": row.held_by, "note": row.note}
            lease = LeaseView(**about, ends=row.lease_ends, fence=row.fence)
        return cls(
            id=row.id,
            simulated=row.simulated,
            connection=row.connection,
            state=row.state,
            interlock=cast(Gate, row.interlock),
            key=cast(Literal["on", "off", "unknown"], row.key_switch),
            shutter=cast(Gate, row.shutter),
            since=row.since,
            last_error=row.last_error,
            lease=lease,
            emergency_stop=stop,
            links={"self": here, "lease": f"{here}/lease", "emergency-stop": f"{here}/emergency-stop"},
        )
