"""Connection to scanners, and discovery of their ports."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from serial.tools import list_ports

from fabry_perot.errors import PortBusy, PortForbidden, ProtocolMismatch, ResponseTimeout, ScannerError
from fabry_perot.hardware.instrument import Instrument
from fabry_perot.host import HostTiming, RecoveryPolicy
from fabry_perot.host.emergency_stop import after_yield
from fabry_perot.host.in_process import LocalTransport
from fabry_perot.host.monitoring_transport import TracingTransport
from fabry_perot.host.port_usage import holder_of, opened_by
from fabry_perot.host.scanner import Scanner
from fabry_perot.host.transport import Transport, open_transport
from fabry_perot.wire.framing import has_native_cobs

_log = logging.getLogger(__name__)
_DEFAULT = RecoveryPolicy()


def connect(
    url: str | Instrument,
    *,
    baudrate: int | None = None,
    timing: HostTiming | None = None,
    recovery: RecoveryPolicy | None = _DEFAULT,
    tap: Callable[[str], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> Scanner:
    """Connect to a scanner: open the port, begin a session and read the capabilities.

    A program that merely watches the scanner (:class:`fabry_perot.Monitor`) gives way. While the session lasts, other
    programs can stop the laser (:func:`fabry_perot.emergency_stop`), which raises ScanAborted here.

    Parameters
    ----------
    url
        A device path or pyserial URL, for example ``/dev/ttyUSB0``, ``socket://127.0.0.1:4001`` or
        ``rfc2217://host:2217`` (a byte at a time in pyserial: some 0.2 MB/s). A path under ``/dev/serial/by-id``
        survives unplugging and plugging in again. Each may end with a baud rate, ``/dev/ttyUSB0?baud=921600``, which
        counts more than ``baudrate``. Or the hardware itself, when it is in this computer
        (:class:`fabry_perot.ComposedInstrument`): the device then runs in a thread of this process, with the same
        lease.
    baudrate
        Baud rate of a UART in Bd, by default 3,000,000.
    timing
        Time limits of the host's side.
    recovery
        How long a scan is carried over a lost line or a restarted device; ``None``: not at all.
    tap
        Called with a line of text for every frame that passes, either way.
    cancelled
        Asked some twenty times a second while no session has come about: once it says so, ResponseTimeout is raised.

    Raises
    ------
    PortBusy, PortForbidden, PortUnavailable, ResponseTimeout, ProtocolMismatch
        There is no scanner to talk to; ResponseTimeout says what the bytes that came tell of the line.
    PlanInvalid
        The baud rate is out of range.
    """
    if not has_native_cobs():
        _log.warning("cobs runs without its C extension: frames are decoded some hundred times slower than need be")

    def reopen() -> Transport:
        transport = open_transport(url, baudrate) if isinstance(url, str) else LocalTransport(url)
        return transport if tap is None else TracingTransport(transport, tap)

    port = url if isinstance(url, str) else None
    again = None if recovery is None or port is None else lambda: after_yield(reopen, port)

    def session() -> Scanner:
        return Scanner(reopen(), timing=timing, recovery=recovery, reopen=again, port=port, cancelled=cancelled)

    try:
        return session() if port is None else after_yield(session, port)
    except PortBusy as error:
        if str(url) in str(error):
            raise
        raise PortBusy(f"{url}: {error}") from None
    except ResponseTimeout as error:
        others = opened_by(port) if port else ""
        if not others:
            raise
        raise ResponseTimeout(f"{error}; {others} has {port} open as well and may read the answers") from None


@dataclass(frozen=True, slots=True)
class DiscoveredPort:
    """Port found by discovery, with the identity of its scanner if probed.

    Parameters
    ----------
    url
        What to give to :func:`connect`.
    description
        What the operating system says of the port.
    model, serial
        What the scanner there says of itself; empty when it was not asked or does not answer.
    busy
        Whether another process holds the port, and so most likely the scanner.
    holder
        Who holds it, for example ``"steradian (process 4242)"``; empty when nobody does, or the system does not tell.
    reason
        Why no scanner could be asked there, as one sentence; empty where one answered, or was not asked.
    """

    url: str
    description: str
    model: str = ""
    serial: str = ""
    busy: bool = False
    holder: str = ""
    reason: str = ""


def discover(urls: Iterable[str] | None = None, *, probe: bool = False, silent: bool = False) -> list[DiscoveredPort]:
    """Return the serial ports of this computer, or the ports ``urls``, each with the scanner found there.

    Parameters
    ----------
    urls
        Ports to look at; by default every serial port the operating system knows.
    probe
        Say HELLO at each of them and keep those where a scanner answers or may be: that are busy, may not be opened by
        this user, or have a scanner of another protocol version. Off by default, because bytes sent to somebody else's
        instrument may do anything.
    silent
        With ``probe``: keep the others, too, with the reason why no scanner answered.
    """
    if urls is None:
        ports = [DiscoveredPort(port.device, port.description) for port in list_ports.comports()]
    else:
        ports = [DiscoveredPort(url, "") for url in urls]
    if not probe:
        return ports
    return [found for port in ports if (found := _probe(port, silent=silent)) is not None]


def _probe(port: DiscoveredPort, *, silent: bool) -> DiscoveredPort | None:
    try:
        with connect(port.url, timing=HostTiming(hello_tries=4), recovery=None) as scanner:
            known = scanner.capabilities
            return replace(port, model=known.model, serial=known.serial)
    except PortBusy as error:
        return replace(port, busy=True, holder=holder_of(port.url), reason=str(error))
    except ScannerError as error:
        told = silent or isinstance(error, PortForbidden | ProtocolMismatch)
        return replace(port, reason=str(error)) if told else None
