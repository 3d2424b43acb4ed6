"""Shot accounting of a scan across reboots of the device."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fabry_perot.host.plan import WirePlan
from fabry_perot.wire.messages import Status


@dataclass(slots=True)
class ShotLedger:
    """Shot counts of a scan over all boots of the device, from the laser's counter, which survives a reboot.

    Parameters
    ----------
    first
        The laser's counter when the scan began.
    refired
        Points fired, lost with a reboot before they arrived, and therefore fired again.
    refired_places
        At how many places they lie: fewer, where several beams record each.
    """

    first: int | None = None
    refired: list[int] = field(default_factory=list)
    refired_places: int = 0
    _boot: int = 0
    _boot_shots: int = 0
    _shots: int = 0
    _start: int = 0
    _wasted: int = 0
    _wasted_before: int = 0

    def record_start(self, boot: int, start: int, laser_shots: int, wasted: int, shots: int = 0) -> None:
        """Record a START; the first START of a scan defines the begin of counting in its boot.

        ``start`` is the first point that the device fires, whatever has arrived when START's answer is looked at;
        ``shots`` is the boot's own count.
        """
        if self.first is None:
            self.first = laser_shots
        if boot != self._boot:
            self._boot, self._start, self._shots, self._wasted_before = boot, start, laser_shots, wasted
            self._boot_shots = shots

    def laser_shots(self, status: Status) -> int:
        """Return the laser's counter at the time of a STATUS; for another boot, at the start of the present boot."""
        return self._shots + (status.shots - self._boot_shots if status.boot == self._boot else 0)

    def record_reboot(self, plan: WirePlan, boot: int, kept: int, laser_shots: int, wasted: int) -> None:
        """Record a reboot: A-lines below ``kept`` were received, the laser's counter is now ``laser_shots``.

        ``wasted`` is the last that was heard of the shots discarded in the boot that ended. Counting begins here in the
        new ``boot``, which has fired nothing yet.
        """
        shots = plan.shots[self._start :].copy()
        shots[0] = max(1, int(plan.points["averages"][self._start]))  # which may lie between a place's beams
        totals = np.cumsum(shots)
        fired = laser_shots - self._shots - (wasted - self._wasted_before)
        count = int(np.searchsorted(totals, fired, side="right"))
        stop = max(kept, self._start + count)
        self.refired += range(kept, stop)
        self.refired_places += plan.places(kept, stop)
        self._wasted += laser_shots - self._shots - (int(totals[count - 1]) if count else 0)
        self._boot, self._start, self._shots, self._wasted_before = boot, kept, laser_shots, 0  # twice changes nothing
        self._boot_shots = 0

    def wasted(self, now: int) -> int:
        """Return the shots discarded in all boots; ``now`` is the device's present count."""
        return self._wasted + now - self._wasted_before


@dataclass(frozen=True, slots=True)
class ScanReport:
    """Shot accounting of one scan: fired, stored, held, re-fired and wasted shots.

    Parameters
    ----------
    points
        Points of the plan.
    fired
        Shots the laser fired for it, over all boots of the device.
    stored
        A-lines the application acknowledged as durably stored.
    held
        A-lines recorded and not (yet) acknowledged.
    refired
        Indices of the points whose first recording was lost with a reboot, in order.
    averages
        Shots per A-line.
    wasted
        Shots of interrupted averages, and of points of which a reboot left nothing to count.
    resumes, restarts, reconnects
        Interruptions: taken up where it stood; planned again after a reboot; ports opened anew.
    repaired
        A-lines or fragments asked for again.
    bad_frames
        Frames the host dropped.
    age
        Seconds since the device's counters were heard; 0 when it was asked for this report. Shots fired after that, at
        most a lease's worth, are not in it.
    places
        How often a place was measured, where several beams record each; ``None``: stored + held + refired.
    """

    points: int
    fired: int
    stored: int
    held: int
    refired: tuple[int, ...]
    averages: int
    wasted: int
    resumes: int
    restarts: int
    reconnects: int
    repaired: int
    bad_frames: int
    age: float = 0.0
    places: int | None = None

    def __repr__(self) -> str:
        names = ("held", "wasted", "resumes", "restarts", "reconnects", "repaired", "bad_frames")
        seen = {name: getattr(self, name) for name in names} | {"refired": len(self.refired)}
        rest = "".join(f", {count:,} {name.replace('_', ' ')}" for name, count in seen.items() if count)
        old = f", heard {self.age:.3g} s ago" if self.age else ""
        return f"<ScanReport: {self.stored:,} of {self.points:,} stored, {self.fired:,} shots fired{rest}{old}>"

    @property
    def is_balanced(self) -> bool:
        """Whether fired = stored + held + re-fired (+ wasted) shots; a shot of several beams counts once."""
        places = self.stored + self.held + len(self.refired) if self.places is None else self.places
        return self.fired == self.averages * places + self.wasted
