"""Addresses of ports: device paths or pyserial URLs, optionally with a baud rate (``/dev/ttyUSB0?baud=921600``)."""

from __future__ import annotations

from urllib.parse import SplitResult, urlsplit

from fabry_perot.errors import PlanInvalid, PortUnavailable

BAUD = 3_000_000
"""Baud rate where none is given, in Bd."""
LOWEST_BAUD, HIGHEST_BAUD = 1_200, 20_000_000
PARAMETER = "baud"
_SOCKET = "socket"


def split(url: str, baudrate: int | None = None) -> tuple[str, int]:
    """Split the parameter ``baud`` from a port's address; return the address without it, and the baud rate in Bd.

    Parameters
    ----------
    url
        A device path or pyserial URL; its parameter ``baud`` counts more than ``baudrate``.
    baudrate
        Baud rate where the URL names none; ``None``: :data:`BAUD`.

    Raises
    ------
    PlanInvalid
        A baud rate is no whole number, or out of range.
    """
    port, said = _parted(url)
    return port, check_baud(PARAMETER if said is not None else "baudrate", said or (baudrate or BAUD))


def port_of(url: str) -> str:
    """Return a port's address without its ``baud`` parameter."""
    return _parted(url)[0]


def names_baud(url: str) -> bool:
    """Return whether a URL contains the parameter ``baud``."""
    return _parted(url)[1] is not None


def with_baud(url: str, baudrate: int) -> str:
    """Return ``url`` with its ``baud`` parameter set.

    Raises
    ------
    PlanInvalid
        The baud rate is out of range.
    """
    port = port_of(url)
    return f"{port}{'&' if '?' in port else '?'}{PARAMETER}={check_baud(PARAMETER, baudrate)}"


def check_baud(field: str, value: object) -> int:
    """Return a valid baud rate in Bd; raises PlanInvalid with the name ``field`` for an invalid one."""
    try:
        baud = int(str(value))
    except ValueError:
        baud = 0
    if not LOWEST_BAUD <= baud <= HIGHEST_BAUD:
        raise PlanInvalid(field, value, f"{LOWEST_BAUD:,} … {HIGHEST_BAUD:,} Bd, a whole number")
    return baud


def check_url(url: str) -> None:
    """Raise PortUnavailable, with the correct syntax, for a URL that does not name a port."""
    if not url.strip():
        raise PortUnavailable("no port is given: give a device path such as /dev/ttyUSB0, or socket://HOST:PORT")
    if "://" not in url:
        return
    try:
        parts = urlsplit(url)
        host, number = parts.hostname, parts.port
    except ValueError:
        raise PortUnavailable(f"cannot open {url}: {_form(url)}") from None
    if parts.scheme == _SOCKET and not (host and number):
        raise PortUnavailable(f"cannot open {url}: {_missing(parts)}; {_form(url)}")


def _missing(parts: SplitResult) -> str:
    return "it names no host" if not parts.hostname else "it names no port number"


def _form(url: str) -> str:
    scheme = url.partition("://")[0]
    return f"the URL has the form {scheme}://HOST:PORT, for example {scheme}://127.0.0.1:4001 (port 1 … 65535)"


def _parted(url: str) -> tuple[str, str | None]:
    head, mark, query = url.rpartition("?")
    if not mark:
        return url, None
    words = query.split("&")
    said = [word.removeprefix(f"{PARAMETER}=") for word in words if word.startswith(f"{PARAMETER}=")]
    if not said:
        return url, None
    rest = "&".join(word for word in words if not word.startswith(f"{PARAMETER}="))
    return (f"{head}?{rest}" if rest else head), said[-1]
