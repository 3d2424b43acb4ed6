"""Command line ``python -m fabry_perot``, which operates a scanner without the Steradian service."""

from __future__ import annotations

import argparse
import json
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from fabry_perot import conformance, connect, discover, emergency_stop, fault_codes
from fabry_perot.errors import PlanInvalid, RequestRejected, ScannerError
from fabry_perot.host import npy_scan_file
from fabry_perot.host.scanner import Scanner
from fabry_perot.host.transport import open_transport
from fabry_perot.wire import constants
from fabry_perot.wire.states import HoldCause

Adder = Callable[..., object]
_LASER = {
    constants.LASER_ARMED: "armed",
    constants.LASER_EMITTING: "emitting",
    constants.SHUTTER_OPEN: "shutter open",
    constants.INTERLOCK_CLOSED: "interlock closed",
    constants.KEY_ON: "key on",
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; an error is one line on standard error and exit code 1, Ctrl-C exit code 130."""
    given = _parser().parse_args(arguments)
    try:
        return int(given.command(given) or 0)
    except (ScannerError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130


def _list(given: argparse.Namespace) -> None:
    """List ports, and with --probe the scanners there, or the reason why a port could not be probed."""
    found = discover(given.urls or None, probe=given.probe, silent=True)
    for port in found:
        what = f"{port.model} {port.serial}".strip() or port.reason.removeprefix(f"{port.url} ") or port.description
        print(f"{port.url}\t{'busy: ' * port.busy}{what}")
    if not any(port.model or not given.probe for port in found):
        print("no port" if not given.probe else "no scanner", file=sys.stderr)


def _status(given: argparse.Namespace) -> None:
    """Print a scanner's identity, its state, and the counters of host and device."""
    with _connect(given) as scanner:
        known = scanner.capabilities
        figures = {name: getattr(known, name) for name in known.__dataclass_fields__}
        figures |= {"state": scanner.state, "laser": _laser(scanner), "cause": HoldCause(scanner.status.cause).name}
        figures |= {name: value for name, value in _statistics(scanner).items() if name not in figures}
        name, advice = _fault(scanner)
    if given.json:
        print(json.dumps(figures | {"fault_name": name}, default=list))
        return
    figures["fault"] = advice or "none"
    width = max(map(len, figures))
    for name, value in figures.items():
        print(f"{name:<{width}}  {value}")


def _statistics(scanner: Scanner) -> dict[str, object]:
    """Return counters of host and device; for failed hardware, those that the device still reports."""
    for _ in range(2):  # a refusal latches the fault, after which the device answers without its hardware
        with suppress(RequestRejected):
            return scanner.statistics()
    return dict(scanner.status._asdict())


def _watch(given: argparse.Namespace) -> None:
    """Print the scanner's state at regular intervals, until Ctrl-C."""
    with _connect(given) as scanner:
        left = given.count
        while left is None or left > 0:
            status, advice = scanner.status, _fault(scanner)[1]
            print(
                f"{status.device_time * 1e-6:12.3f} s  {scanner.state:<9} laser {_laser(scanner)}; "
                f"{status.produced} A-lines, {status.acknowledged} acknowledged, {status.shots} shots"
                f"{'; ' * bool(advice)}{advice}",
                flush=True,
            )
            left = None if left is None else left - 1
            if left != 0:
                time.sleep(given.interval)


def _stop(given: argparse.Namespace) -> int:
    """Turn the laser off, whichever program holds the port, and print the scanner's state; exit code 1: unconfirmed."""
    outcome = emergency_stop(given.url, baudrate=given.baud, who=given.by)
    by = f"; the port is held by {outcome.holder}" if outcome.holder else ""
    off = outcome.laser == "off"
    print(f"laser {outcome.laser}: {outcome.detail}{by if off else ''}", file=sys.stdout if off else sys.stderr)
    return 0 if off else 1


def _clear_fault(given: argparse.Namespace) -> None:
    """Clear a latched fault or emergency stop in a person's name; refused while the cause persists; laser stays off."""
    if not given.by.strip():
        raise PlanInvalid("by", given.by, "the name of a person")
    with _connect(given) as scanner:
        print(scanner.clear_fault(given.by.strip()))


def _tune(given: argparse.Namespace) -> None:
    """Sweep the interrogation wavelength at points of the film, and print or save the optimum wavelengths."""
    points = np.zeros((1, 2)) if given.points is None else npy_scan_file.read_points(given.points)
    with _connect(given) as scanner:
        tuned = scanner.pretune(points, steps=given.steps)
    rows = zip(tuned.points.tolist(), tuned.wavelength, tuned.sensitivity, tuned.reflectivity, strict=True)
    for (x, y), wavelength, sensitivity, reflectivity in rows:
        print(
            f"{1e3 * x:8.3f} mm {1e3 * y:8.3f} mm  bias {1e9 * wavelength:.4f} nm  "
            f"slope {1e-9 * sensitivity:.3g} V/nm  level {reflectivity:.3g} V"
        )
    if given.output is not None:
        tuned.save(given.output)
        print(f"{len(points)} points in {_path_with_size(given.output)}")


def _scan(given: argparse.Namespace) -> int:
    """Measure points and save the A-lines in a NumPy file; Ctrl-C turns the laser off and saves the A-lines so far."""
    points, asked = npy_scan_file.read_points(given.points), False

    def stop(*_: object) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True

    with connect(given.url, baudrate=given.baud, tap=_to_stderr if given.frames else None) as scanner:
        scanner.upload(
            points,
            samples=given.samples,
            sampling_interval=given.interval,
            pulse_rate=given.rate,
            averages=given.averages,
        )
        rows = npy_scan_file.create(given.output, points, given.samples)
        before, done = signal.signal(signal.SIGINT, stop), False
        try:
            done = npy_scan_file.run_and_store(scanner, rows, stopping=lambda: asked, progress=_counter(len(points)))
        finally:
            signal.signal(signal.SIGINT, before)
            kept = f"{int(rows['stored'].sum())} of {len(points)} A-lines in {_path_with_size(given.output)}"
            print(f"laser off; {kept}" if asked and not done else kept)
        print(scanner.report(), file=sys.stderr)
    return 0 if done else 130


def _monitor(given: argparse.Namespace) -> None:
    """Begin a session and show every frame in both directions, until Ctrl-C."""
    with connect(given.url, baudrate=given.baud, tap=_print):
        threading.Event().wait(given.seconds)


def _conformance(given: argparse.Namespace) -> int:
    """Test whether a device conforms to PROTOCOL.md; disconnect the laser first."""
    transport = open_transport(given.url, given.baud)
    try:
        outcomes = conformance.run(
            conformance.ConformanceHost(transport),
            fire=given.fire,
            ask=_ask if given.ask else None,
            only=given.only or (),
            told=lambda outcome: _print(conformance.as_table([outcome])),
        )
    finally:
        transport.close()
    failed, skipped = sum(bool(one.failure) for one in outcomes), sum(bool(one.skipped) for one in outcomes)
    print(f"{len(outcomes) - failed - skipped} passed, {failed} failed, {skipped} skipped")
    if given.junit is not None:
        given.junit.write_bytes(conformance.as_junit(outcomes, given.url))
    return 1 if failed or skipped == len(outcomes) else 0


def _ask(wish: str) -> None:
    input(f"Please {wish}, then press Enter. ")


def _connect(given: argparse.Namespace) -> Scanner:
    return connect(given.url, baudrate=given.baud)


def _print(line: str) -> None:
    print(line, flush=True)


def _to_stderr(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _counter(total: int) -> Callable[[int], None]:
    def show(stored: int) -> None:
        if sys.stderr.isatty():
            print(f"\r{stored} of {total}", end="\n" if stored == total else "", file=sys.stderr, flush=True)

    return show


def _laser(scanner: Scanner) -> str:
    bits = scanner.status.laser
    return ", ".join(name for bit, name in _LASER.items() if bits & bit) or "off"


def _fault(scanner: Scanner) -> tuple[str, str]:
    """Return the name of a latched fault, and a sentence with its remedy; both empty without a fault."""
    if scanner.state not in ("fault", "estop"):
        return "", ""
    code = scanner.status.fault if scanner.state == "fault" else 0
    return fault_codes.by_code(code).name, fault_codes.advice(code)


def _path_with_size(path: Path) -> str:
    return f"{path} ({path.stat().st_size:,} bytes)"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="fabry-perot", description=main.__doc__)
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    port = argparse.ArgumentParser(add_help=False)
    port.add_argument("url", metavar="PORT", help="/dev/ttyUSB0, socket://HOST:PORT, rfc2217://HOST:PORT")
    port.add_argument(
        "--baud", type=int, help="of a UART, default 3000000; PORT may name it, too: /dev/ttyUSB0?baud=921600"
    )

    def command(name: str, function: Callable[[argparse.Namespace], object], *, ports: bool = True) -> Adder:
        about = " ".join((function.__doc__ or "").split())
        made = commands.add_parser(name, help=about, description=about, parents=[port] if ports else [])
        made.set_defaults(command=function)
        return made.add_argument

    add = command("list", _list, ports=False)
    add("urls", nargs="*", metavar="PORT", help="ports to probe; default: all ports of the system")
    add(
        "--probe",
        action="store_true",
        help="send HELLO to each port and print the scanner that answers, or the reason why none does",
    )
    add = command("status", _status)
    add("--json", action="store_true", help="as one JSON object")
    add = command("watch", _watch)
    add("--interval", type=float, default=1.0, metavar="S", help="seconds between lines")
    add("--count", type=int, metavar="N", help="end after so many lines")
    add = command("stop", _stop)
    add("--by", default="", metavar="NAME", help="name of the person, for the program that holds the port")
    add = command("clear-fault", _clear_fault)
    add("--by", required=True, metavar="NAME", help="name of the person who confirmed that the cause is removed")
    add = command("tune", _tune)
    add("--points", type=Path, metavar="FILE", help="x_mm,y_mm as CSV, or (M, 2) m as .npy; default: the centre")
    add("--steps", type=int, default=101, help="wavelengths in a sweep, 2 to 256")
    add("--output", "-o", type=Path, metavar="FILE", help="keep the map (.npz)")
    add = command("scan", _scan)
    add("points", type=Path, metavar="POINTS", help="x_mm,y_mm as CSV, or (M, 2) m as .npy, in the order of visiting")
    add("--output", "-o", type=Path, default=Path("scan.npy"), metavar="FILE", help="the file to write (.npy)")
    add("--samples", type=int, default=1024, help="per A-line")
    add("--interval", type=float, default=8e-9, metavar="S", help="seconds between samples")
    add("--rate", type=float, default=50.0, metavar="HZ", help="laser pulses per second")
    add("--averages", type=int, default=1, help="pulses averaged into one A-line")
    add("--frames", action="store_true", help="show every frame on standard error")
    add = command("conformance", _conformance)
    add("--fire", action="store_true", help="include tests that open the shutter of a device that is not simulated")
    add("--ask", action="store_true", help="include tests that need an action by a person: power, interlock")
    add("--only", nargs="+", metavar="NAME", help="scenarios; default: all")
    add("--junit", type=Path, metavar="FILE", help="keep the outcome as JUnit XML")
    add = command("monitor", _monitor)
    add("--seconds", type=float, metavar="S", help="end after so long")
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
