"""asyncio wrapper of the synchronous driver.

There is no second implementation to go wrong. A-lines are looked for in that thread, a twentieth of a second at a time,
and each look renews the laser's lease once: a consumer that was cancelled, and an event loop that hangs, drop the laser
as a hung application should.
"""

from __future__ import annotations

import asyncio
import functools
from collections.abc import AsyncIterator, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType
from typing import Any, ParamSpec, Self, TypeVar

from fabry_perot.hardware.instrument import Instrument
from fabry_perot.host import ScanReport
from fabry_perot.host.aline import ALine, ALineBatch
from fabry_perot.host.capabilities import Capabilities
from fabry_perot.host.discovery import connect
from fabry_perot.host.query_results import FaultCleared
from fabry_perot.host.scanner import Scanner
from fabry_perot.host.tuning import TuningCurve, TuningMap
from fabry_perot.wire.messages import Status

P = ParamSpec("P")
T = TypeVar("T")


class AsyncScanner:
    """Connected scanner for asyncio; use :func:`connect_async` and an ``async with`` block.

    Every method does what the one of the same name of :class:`fabry_perot.Scanner` does and raises the same errors.

    Parameters
    ----------
    scanner
        The synchronous driver.
    """

    def __init__(self, scanner: Scanner) -> None:
        self._scanner = scanner
        self._calls = ThreadPoolExecutor(2, thread_name_prefix="fabry-perot-call")
        self._coming: asyncio.Future[ALineBatch | None] | None = None
        """The next batch; one whose consumer was cancelled meanwhile is for the next consumer."""

    def __repr__(self) -> str:
        return repr(self._scanner).replace("Scanner", type(self).__name__, 1)

    async def _run(self, function: Callable[P, T], *given: P.args, **named: P.kwargs) -> T:
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self._calls, functools.partial(function, *given, **named))

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    @property
    def capabilities(self) -> Capabilities:
        """Limits and identity of the scanner."""
        return self._scanner.capabilities

    @property
    def state(self) -> str:
        """The device's state in lower case."""
        return self._scanner.state

    @property
    def status(self) -> Status:
        """The device's last STATUS."""
        return self._scanner.status

    async def upload(self, points: Any, **parameters: Any) -> None:
        """Upload a plan; parameters as of :meth:`fabry_perot.Scanner.upload`."""
        await self._run(self._scanner.upload, points, **parameters)

    async def arm(self) -> int:
        """Arm the laser and return the token for :meth:`start`."""
        return await self._run(self._scanner.arm)

    async def start(self, token: int) -> None:
        """Start the scan of the uploaded plan."""
        await self._run(self._scanner.start, token)

    async def alines(self) -> AsyncIterator[ALineBatch]:
        """Yield batches of A-lines as they arrive, until the plan is complete; iterate again after a cancellation."""
        batches = self._scanner.alines(idle=True)
        while True:
            coming = self._coming
            if coming is None:
                coming = self._coming = asyncio.ensure_future(self._run(_following, batches))
            try:
                batch = await asyncio.shield(coming)
            except BaseException as error:
                # a consumer that was cancelled has taken nothing; an error that was raised here is told
                if coming.cancelled() or not isinstance(error, asyncio.CancelledError):
                    self._coming = None
                raise
            self._coming = None
            if batch is None:
                return
            if batch:
                yield batch

    async def acknowledge(self, aline: ALine) -> None:
        """Declare ``aline`` and all before it durably stored."""
        await self._run(self._scanner.acknowledge, aline)

    async def pause(self) -> None:
        """Pause the scan, with the laser off, until :meth:`resume`."""
        await self._run(self._scanner.pause)

    async def resume(self, *, by_itself: bool = False) -> None:
        """Arm the laser and continue the scan; parameters as of :meth:`fabry_perot.Scanner.resume`."""
        await self._run(self._scanner.resume, by_itself=by_itself)

    async def abort(self, level: str = "laser-off") -> None:
        """Send an abort with a level: pause, laser-off (default) or emergency-stop."""
        await self._run(self._scanner.abort, level)

    async def disarm(self) -> None:
        """Invalidate the arm token, or end a scan without discarding its plan and data."""
        await self._run(self._scanner.disarm)

    async def park(self) -> None:
        """Close the shutter and move the beam to the rest position."""
        await self._run(self._scanner.park)

    async def clear_fault(self, by: str = "") -> FaultCleared:
        """Clear a latched fault or emergency stop in a person's name."""
        return await self._run(self._scanner.clear_fault, by)

    async def set(self, **parameters: int) -> dict[str, int]:
        """Set parameters of the device."""
        return await self._run(self._scanner.set, **parameters)

    async def tune(self, x: float, y: float, **sweep: Any) -> TuningCurve:
        """Sweep the interrogation wavelength at one point, and return the tuning curve."""
        return await self._run(self._scanner.tune, x, y, **sweep)

    async def measure_tuning_map(self, points: Any, *, steps: int = 101) -> TuningMap:
        """Sweep the interrogation wavelength at each point, and return the tuning map."""
        return await self._run(self._scanner.pretune, points, steps=steps)

    async def statistics(self) -> dict[str, Any]:
        """Return counters of host and device."""
        return await self._run(self._scanner.statistics)

    async def report(self) -> ScanReport:
        """Return the shot accounting of the present scan."""
        return await self._run(self._scanner.report)

    async def close(self) -> None:
        """Switch the laser off if it is on, and release the port."""
        await self._run(self._scanner.close)
        self._calls.shutdown(wait=False)


def _following(batches: Iterator[ALineBatch]) -> ALineBatch | None:
    return next(batches, None)


async def connect_async(url: str | Instrument, **parameters: Any) -> AsyncScanner:
    """Open a port, begin a session and read the capabilities; parameters as of :func:`fabry_perot.connect`."""
    return AsyncScanner(await asyncio.to_thread(connect, url, **parameters))
