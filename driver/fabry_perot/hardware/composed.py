"""Instrument composed of galvo, interrogation laser, digitiser, excitation laser and shutter."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from fabry_perot.hardware.averaging import MISSING_ENERGY, average_shots
from fabry_perot.hardware.components import (
    BeamPath,
    Digitiser,
    ExcitationLaser,
    Galvo,
    GatedLaser,
    InterrogationLaser,
    Shutter,
    TriggerRecord,
)
from fabry_perot.hardware.instrument import Instrument, InstrumentError, PlanSampling, PointRecord
from fabry_perot.wire.constants import FLAG_GATE, MOST_BEAMS

FAULT_GALVO, FAULT_LASER, FAULT_DIGITISER, FAULT_EXCITATION, FAULT_GUARD = 4, 5, 6, 7, 8
"""Fault codes: whose call failed; the last one is shutter, interlock or key."""
POLL_INTERVAL = 500
"""Something under way is looked after every so many µs."""
READY_TIMEOUT = 100_000
"""Records still missing so many µs after the last pulse left mean a digitiser that misses triggers."""
MAX_BLOCK = 64
"""Points armed together."""
P = ParamSpec("P")
T = TypeVar("T")


class ComposedInstrument(Instrument):
    """Real instrument assembled from separately driven hardware components.

    Points are cut into blocks that the hardware takes by its own triggers: points in a row with one bias wavelength, as
    many as the galvo can step through by itself; one that waits for the gate begins a block. Whatever a part raises
    becomes an :class:`InstrumentError` that names it.

    Parameters
    ----------
    galvo, laser, digitiser, excitation, shutter
        The parts; ``laser`` is the interrogation laser.
    model, serial
        Identity, for capabilities.
    beams
        (B, 2) where the interrogation beams are beside the first one, which the galvo steers, in nm: the first is
        (0, 0). All are read through the one interrogation laser, at one wavelength.

    Raises
    ------
    ValueError
        When the pattern of beams is none.
    """

    def __init__(
        self,
        *,
        galvo: Galvo,
        laser: InterrogationLaser,
        digitiser: Digitiser,
        excitation: ExcitationLaser,
        shutter: Shutter,
        model: str = "Fabry-Perot scanner",
        serial: str = "",
        beams: Sequence[tuple[int, int]] = ((0, 0),),
    ) -> None:
        if not 1 <= len(beams) <= MOST_BEAMS or tuple(beams[0]) != (0, 0):
            raise ValueError(f"beams: {len(beams)} of them, the first at {beams[:1]}; 1 to {MOST_BEAMS} from (0, 0) on")
        self.galvo, self.laser, self.digitiser = galvo, laser, digitiser
        self.excitation, self.shutter = excitation, shutter
        self._identity = {"model": model, "serial": serial}
        self.pattern = [(int(x), int(y)) for x, y in beams]
        self._samples, self._beams, (self._least, self._most) = 0, 1, MISSING_ENERGY
        self._queue: deque[tuple[int, np.void]] = deque()
        self._block: deque[tuple[int, np.void]] = deque()
        self._firing = self._gated = False
        self._pulses = self._until = 0
        """The laser's count when the present block is complete; what was permitted last."""
        self._records: list[TriggerRecord] = []
        self._done: list[PointRecord] = []
        self._sweep: deque[int] | None = None
        self._levels: list[int] = []

    def capabilities(self) -> dict[str, Any]:
        """Return the combined limits of all components; override this method for further capabilities."""
        laser = self._ask(FAULT_LASER, self.laser.limits)
        excitation = self._ask(FAULT_EXCITATION, self.excitation.limits)
        parameters = {**laser.pop("parameters", {}), **excitation.pop("parameters", {})}
        self._least, self._most = excitation.get("energy_range", MISSING_ENERGY)
        return {
            **self._identity,
            "simulated": False,
            "averages": [1, 1000],
            "beams": len(self.pattern),
            "beam_offsets_nm": [list(beam) for beam in self.pattern],
            "encodings": [0, 1],
            "clock_rate": 1.0,
            "line_rate": 0,
            **self._ask(FAULT_GALVO, self.galvo.limits),
            **laser,
            **self._ask(FAULT_DIGITISER, self.digitiser.limits),
            **excitation,
            "parameters": parameters,
        }

    def begin(self, sampling: PlanSampling) -> None:
        """Configure digitiser and excitation laser for a plan."""
        self._samples, self._beams = sampling.samples, sampling.beams
        self._queue.clear()
        self._done.clear()
        self._ask(FAULT_DIGITISER, self.digitiser.begin, sampling)
        self._ask(FAULT_EXCITATION, self.excitation.begin, sampling)

    def queue_points(self, first: int, points: NDArray[np.void], now: int) -> None:
        """Queue more points for measurement."""
        self._queue.extend(enumerate(points, start=first))

    def permit(self, until: int, now: int) -> None:
        """Permit pulses before ``until``; a gated block whose permission has expired is queued again."""
        lapsed, self._until = now >= self._until, until
        if lapsed and self._firing and self._gated:
            self._queue.extendleft(reversed(self._break_off(now)))
        self._ask(FAULT_EXCITATION, self.excitation.permit, until, now)

    def poll(self, now: int) -> list[PointRecord]:
        """Collect finished records and start the next block."""
        if self._firing:
            self._collect(now)
        if not self._block and self._queue:
            self._aim(now)
        if self._block and not self._firing and self._aimed(now):
            self._fire(now)
        done, self._done = self._done, []
        return done

    def next_due(self, now: int) -> int | None:
        """Return the time of the next poll."""
        return now + POLL_INTERVAL if self._queue or self._block or self._sweep is not None else None

    def stop(self, now: int) -> None:
        """Stop firing and discard all points; complete records are returned by the next poll."""
        self._queue.clear()
        self._sweep = None
        self._break_off(now)

    def _break_off(self, now: int) -> list[tuple[int, np.void]]:
        """Stop firing, discard the records of incomplete points of the block, and return those points."""
        try:
            self._ask(FAULT_EXCITATION, self.excitation.halt, now)
            if self._firing:
                self._collect(now)
        finally:
            unfinished = list(self._block)
            self._block.clear()
            self._records.clear()
            self._firing = False
            self._ask(FAULT_DIGITISER, self.digitiser.disarm)
        return unfinished

    def shots(self) -> int:
        """Return the excitation laser's own count of shots."""
        return self._ask(FAULT_EXCITATION, self.excitation.shots)

    def last_shot(self) -> int:
        """Return the time of the last emitted pulse."""
        return self._ask(FAULT_EXCITATION, self.excitation.last_shot)

    def sweep(self, x: int, y: int, wavelengths: NDArray[np.int64], now: int) -> None:
        """Start a sweep of the interrogation wavelength at a point."""
        self._sweep, self._levels = deque(wavelengths.tolist()), []
        one, none = np.ones(1, np.int64), np.zeros(1, np.int64)
        self._ask(FAULT_GALVO, self.galvo.start_path, BeamPath(x * one, y * one, none, none), now)
        self._ask(FAULT_LASER, self.laser.tune, self._sweep[0], now)

    def sweep_result(self, now: int) -> list[int] | None:
        """Measure the level at a reached wavelength and tune to the next; return all levels at the end."""
        if self._sweep is None or not self._aimed(now):
            return None
        self._levels.append(self._ask(FAULT_DIGITISER, self.digitiser.level, now))
        self._sweep.popleft()
        if self._sweep:
            self._ask(FAULT_LASER, self.laser.tune, self._sweep[0], now)
            return None
        self._sweep = None
        return self._levels

    def open(self) -> None:
        """Open the shutter of the excitation beam."""
        self._ask(FAULT_GUARD, self.shutter.open)

    def close(self) -> None:
        """Close the shutter of the excitation beam."""
        self._ask(FAULT_GUARD, self.shutter.close)

    def shutter_open(self) -> bool:
        """Return whether the shutter is open."""
        return self._ask(FAULT_GUARD, self.shutter.is_open)

    def emitting(self) -> bool:
        """Return whether light may be emitted, according to the laser's own monitor."""
        return self._ask(FAULT_EXCITATION, self.excitation.emitting)

    def interlock_closed(self) -> bool:
        """Return whether the interlock is closed."""
        return self._ask(FAULT_GUARD, self.shutter.interlock_closed)

    def key_on(self) -> bool:
        """Return whether the key is on."""
        return self._ask(FAULT_GUARD, self.shutter.key_on)

    def park(self, now: int) -> None:
        """Move the galvo to its rest position."""
        self._ask(FAULT_GALVO, self.galvo.park, now)

    def position(self) -> tuple[int, int]:
        """Return the beam position x, y in nm."""
        return self._ask(FAULT_GALVO, self.galvo.position)

    def parameters(self) -> dict[str, int]:
        """Return the values of the adjustable parameters of both lasers."""
        excitation = self._ask(FAULT_EXCITATION, self.excitation.parameters)
        return {**self._ask(FAULT_LASER, self.laser.parameters), **excitation}

    def configure(self, name: str, value: int) -> None:
        """Set an adjustable parameter of the laser that has it."""
        if name in self._ask(FAULT_LASER, self.laser.parameters):
            self._ask(FAULT_LASER, self.laser.configure, name, value)
        else:
            self._ask(FAULT_EXCITATION, self.excitation.configure, name, value)

    def _aim(self, now: int) -> None:
        """Take the next block of points from the queue, tune the laser, and move to the first point."""
        block, bias = self._block, self._bias(self._queue[0][1])
        block.append(self._queue.popleft())
        most = MAX_BLOCK if self.galvo.steps_by_trigger else 1
        while self._queue and len(block) < most and self._goes_on(self._queue[0][1], bias):
            block.append(self._queue.popleft())
        points = np.array([point for _, point in block])
        shots = np.maximum(points["averages"].astype(np.int64), 1)
        x, y = points["x"].astype(np.int64), points["y"].astype(np.int64)
        path = BeamPath(x, y, shots, points["settle"] * np.int64(100))
        self._ask(FAULT_GALVO, self.galvo.start_path, path, now)
        self._ask(FAULT_LASER, self.laser.tune, bias, now)

    def _goes_on(self, point: np.void, bias: int) -> bool:
        """Return whether a point may join the present block: same wavelength and no wait for the gate."""
        return not int(point["flags"]) & FLAG_GATE and self._bias(point) == bias

    def _bias(self, point: np.void) -> int:
        asked = int(point["wavelength"])
        return asked or self._ask(FAULT_LASER, self.laser.bias, int(point["x"]), int(point["y"]))

    def _aimed(self, now: int) -> bool:
        return self._ask(FAULT_GALVO, self.galvo.is_settled, now) and self._ask(FAULT_LASER, self.laser.tuned, now)

    def _fire(self, now: int) -> None:
        pulses = sum(max(1, int(point["averages"])) for _, point in self._block)
        self._pulses, self._firing = self.shots() + pulses, True
        self._ask(FAULT_DIGITISER, self.digitiser.arm, pulses, now)
        self._gated = bool(int(self._block[0][1]["flags"]) & FLAG_GATE)
        if self._gated:
            fire_at_gate = self._ask(FAULT_EXCITATION, getattr, self.excitation, GatedLaser.fire_at_gate.__name__)
            self._ask(FAULT_EXCITATION, fire_at_gate, pulses, now)
        else:
            self._ask(FAULT_EXCITATION, self.excitation.fire, pulses, now)

    def _collect(self, now: int) -> None:
        """Read records from the digitiser, and average those of each complete point into A-lines."""
        for record in self._ask(FAULT_DIGITISER, self.digitiser.records, now):
            if not self._block:
                raise InstrumentError(FAULT_DIGITISER, "more records than triggers were armed")
            if (samples := record.samples).shape != (self._samples,):
                raise InstrumentError(FAULT_DIGITISER, f"a record of {samples.size} samples, not {self._samples}")
            index, point = self._block[0]
            if record.beam != (due := len(self._records) % self._beams):
                raise InstrumentError(FAULT_DIGITISER, f"a record of beam {record.beam} where beam {due} is due")
            self._records.append(record)
            if len(self._records) >= self._beams * max(1, int(point["averages"])):
                self._block.popleft()
                beams = (self._records[beam :: self._beams] for beam in range(self._beams))
                self._done += [average_shots(index, each, (self._least, self._most)) for each in beams]
                self._records = []
        if not self._block:
            self._firing = False
        elif self.shots() >= self._pulses and now - self.last_shot() > READY_TIMEOUT:
            raise InstrumentError(FAULT_DIGITISER, f"records of {len(self._block)} points are missing")

    def _ask(self, fault: int, call: Callable[P, T], *given: P.args, **named: P.kwargs) -> T:
        """Call a method of a component and return its result; any exception becomes a fault of that component."""
        try:
            return call(*given, **named)
        except InstrumentError:
            raise
        except Exception as error:
            raise InstrumentError(fault, f"{getattr(call, '__qualname__', call)}: {error}") from error
