"""Control channel of the simulator, with JSON-lines commands for faults and reports.

============================================  =========================================================================
command                                       what it does; all durations in seconds of simulator time
============================================  =========================================================================
``{"do": "unplug", "seconds": 1}``            takes the line away; a pseudo-terminal comes back under its link
``{"do": "reboot", "seconds": 0.5}``          the firmware loses power; hardware and laser counter stay
``{"do": "stall", "way": "up", "seconds": 3}``  holds bytes to (``up``) or from (``down``) the device for a time
``{"do": "cut", "way": "up", "seconds": 1}``  loses them
``{"do": "noise", "way": "up", "bit_errors": 1e-5, "lost_frames": 0.01}``  from now on; zeros end it
``{"do": "interlock", "closed": false}``      opens or closes the enclosure
``{"do": "key", "on": false}``                turns the key switch
``{"do": "drift", "pm": 300}``                shifts the film's resonances
``{"do": "report"}``                          nothing; with ``"fired": false`` the answer leaves the list of shots out
============================================  =========================================================================

Each answer holds ``time`` (simulator time, µs), ``shots`` (fired since start), ``last_shot`` (its time), ``ring_peak``,
``boots``, the device's ``state`` and whether the ``shutter`` is open; that of ``report`` also ``fired``, the (time,
point) of the last 200,000 shots: writing them takes tenths of a second, for which the simulator, and with it its
clock, stands still. With ``"moves": true`` it holds ``moves``, the last 2,000 movements of the shutter as (time, this
computer's monotonic clock in s, whether it opened). A command that is not understood is answered with ``error``.
"""

from __future__ import annotations

import json
from typing import Any

from fabry_perot.simulator.line_faults import BitFlips, Delay, DropAll, FrameLoss
from fabry_perot.simulator.server import Server


class Commands:
    """Executor of control commands on a running simulator.

    Parameters
    ----------
    server
        The simulator.
    seed
        Of the faults.
    """

    def __init__(self, server: Server, seed: int) -> None:
        self._server, self._seed = server, seed
        self._pending = b""

    def feed(self, data: bytes) -> list[bytes]:
        """Process bytes from the channel and return the answers, one line each."""
        lines = (self._pending + data).split(b"\n")
        self._pending = lines.pop()
        return [json.dumps(self._answer(line)).encode() + b"\n" for line in lines if line.strip()]

    def _answer(self, line: bytes) -> dict[str, Any]:
        try:
            command = json.loads(line)
            return {"did": command["do"], **getattr(self, f"_do_{command.pop('do')}")(**command)}
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            return {"error": f"{type(error).__name__}: {error}"}

    def _state(self) -> dict[str, Any]:
        machine = self._server.machine
        log = machine.instrument.log
        return {
            "time": self._server.time,
            "shots": machine.instrument.shots(),
            "last_shot": log[-1][0] if log else 0,
            "ring_peak": max(machine.ring_peak, machine.device.ring.peak),
            "boots": machine.boots,
            "state": machine.device.state.name.lower(),
            "shutter": machine.instrument.shutter_open(),
        }

    def _do_report(self, fired: bool = True, moves: bool = False) -> dict[str, Any]:
        shots = {"fired": list(self._server.machine.instrument.log)} if fired else {}
        shutter = {"moves": list(self._server.shutter_log)} if moves else {}
        return {**self._state(), **shots, **shutter}

    def _do_unplug(self, seconds: float) -> dict[str, Any]:
        self._server.unplug(int(seconds * 1e6))
        return self._state()

    def _do_reboot(self, seconds: float = 0.5) -> dict[str, Any]:
        self._server.machine.reboot(self._server.time, int(seconds * 1e6))
        return self._state()

    def _do_stall(self, way: str, seconds: float) -> dict[str, Any]:
        now = self._server.time
        self._chain(way).append(Delay(now, now + int(seconds * 1e6)))
        return self._state()

    def _do_cut(self, way: str, seconds: float) -> dict[str, Any]:
        now = self._server.time
        self._chain(way).append(DropAll(now, now + int(seconds * 1e6)))
        return self._state()

    def _do_noise(self, way: str, bit_errors: float = 0.0, lost_frames: float = 0.0) -> dict[str, Any]:
        filters = self._chain(way)
        filters[:] = [item for item in filters if not isinstance(item, BitFlips | FrameLoss)]
        if bit_errors:
            filters.append(BitFlips(self._seed, bit_errors))
        if lost_frames:
            filters.append(FrameLoss(self._seed, lost_frames))
        return self._state()

    def _do_interlock(self, closed: bool) -> dict[str, Any]:
        self._server.machine.instrument.shutter.closed = bool(closed)
        return self._state()

    def _do_key(self, on: bool) -> dict[str, Any]:
        self._server.machine.instrument.shutter.key = bool(on)
        return self._state()

    def _do_drift(self, pm: int) -> dict[str, Any]:
        self._server.machine.instrument.recorder.film.drift = int(pm)
        return self._state()

    def _chain(self, way: str) -> list[Any]:
        return {"up": self._server.up, "down": self._server.down}[way].filters
