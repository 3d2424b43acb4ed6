"""Simulated tunable laser: a process that answers SCPI on a TCP port.

It knows ``*IDN? *RST *CLS *ESR? *OPC *OPC?``, ``:SYSTem:ERRor?``, ``[:SOURce]:WAVelength`` (also ``? MIN``, ``? MAX``),
``:POWer`` and ``:POWer:STATe`` as the HP/Agilent 8168 does, and ``:LIGHt?`` for the rest of the bench, which sees its
light: the wavelength now, also while it tunes, and its power.
"""

from __future__ import annotations

import argparse
import re
import socketserver
import threading
import time

LOWEST, HIGHEST = 1_545e-9, 1_555e-9
UNITS = {"": 1.0, "M": 1.0, "NM": 1e-9, "PM": 1e-12, "UM": 1e-6}
POWERS = {"": 1.0, "W": 1.0, "MW": 1e-3, "UW": 1e-6}
COMPLETE, EXECUTION, COMMAND = 0x01, 0x10, 0x20
NUMBER = re.compile(r"([-+0-9.eE]+?)\s*([A-Z]*)$", re.IGNORECASE)


class Laser:
    """State of the simulated laser, and its SCPI commands; connections are served one command at a time."""

    def __init__(self, tuning: float) -> None:
        self._tuning, self._lock = tuning, threading.Lock()
        self._errors: list[str] = []
        self._reset()

    def _reset(self) -> None:
        self._from = self._to = 1_550e-9
        self._begun, self._power, self._on = 0.0, 1e-3, False
        self._events, self._completing = 0, False

    def wavelength(self) -> float:
        """Return the present wavelength in m, which changes linearly while the laser tunes."""
        share = min(1.0, (time.monotonic() - self._begun) / self._tuning)
        return self._from + (self._to - self._from) * share

    def _tuned(self) -> bool:
        return time.monotonic() - self._begun >= self._tuning

    def answer(self, line: str) -> str | None:
        """Execute a line of commands; return the answers to its queries."""
        with self._lock:
            answers = [found for each in line.split(";") if (found := self._one(each.strip())) is not None]
        return ";".join(answers) if answers else None

    def _one(self, command: str) -> str | None:
        if not command:
            return None
        head, _, argument = command.partition(" ")
        head = re.sub(r"^:?(SOUR(CE)?\d?:)?|^:", "", head.upper())
        head = head.replace("WAVELENGTH", "WAV").replace("POWER", "POW").replace("STATE", "STAT")
        head = head.replace("SYSTEM", "SYST").replace("ERROR", "ERR").replace("LIGHT", "LIGH")
        try:
            return self._do(head, argument.strip().upper())
        except ValueError as error:
            self._events |= EXECUTION
            self._errors.append(f'-222,"Data out of range; {error}"')
        except KeyError:
            self._events |= COMMAND
            self._errors.append(f'-113,"Undefined header; {head}"')
        return None

    def _do(self, head: str, argument: str) -> str | None:
        match head:
            case "*IDN?":
                return "BENCH,TUNABLE LASER,0,1.0"
            case "*RST":
                self._reset()
            case "*CLS":
                self._events, self._errors, self._completing = 0, [], False
            case "*OPC":
                self._completing = True
            case "*OPC?":
                while not self._tuned():
                    time.sleep(1e-4)
                return "1"
            case "*ESR?":
                if self._completing and self._tuned():
                    self._events, self._completing = self._events | COMPLETE, False
                events, self._events = self._events, 0
                return str(events)
            case "SYST:ERR?":
                return self._errors.pop(0) if self._errors else '+0,"No error"'
            case "WAV?":
                return f"{ {'MIN': LOWEST, 'MAX': HIGHEST}.get(argument, self._to):+.9E}"
            case "WAV":
                wanted = _number(argument, UNITS)
                if not LOWEST - 1e-15 < wanted < HIGHEST + 1e-15:
                    raise ValueError(argument)
                self._from, self._to, self._begun = self.wavelength(), wanted, time.monotonic()
            case "POW?":
                return f"{self._power:+.6E}"
            case "POW":
                wanted = _number(argument, POWERS)
                if not 1e-4 <= wanted <= 5e-3:
                    raise ValueError(argument)
                self._power = wanted
            case "POW:STAT?":
                return str(int(self._on))
            case "POW:STAT":
                self._on = argument in ("1", "ON")
            case "LIGH?":
                return f"{self.wavelength():.12e},{self._power if self._on else 0.0:.6e}"
            case _:
                raise KeyError(head)
        return None


def _number(text: str, units: dict[str, float]) -> float:
    found = NUMBER.match(text)
    if found is None or found[2].upper() not in units:
        raise ValueError(text)
    return float(found[1]) * units[found[2].upper()]


def main() -> None:
    """Run the SCPI server until the process is ended."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--port", type=int, default=0, help="TCP port; 0 takes any free one, which is printed")
    parser.add_argument("--tuning", type=float, default=5e-3, help="s")
    given = parser.parse_args()
    laser = Laser(given.tuning)

    class Connection(socketserver.StreamRequestHandler):
        disable_nagle_algorithm = True

        def handle(self) -> None:
            for line in self.rfile:
                answer = laser.answer(line.decode("ascii", "replace").strip())
                if answer is not None:
                    self.wfile.write(answer.encode() + b"\n")

    class Server(socketserver.ThreadingTCPServer):
        allow_reuse_address = daemon_threads = True

    with Server(("127.0.0.1", given.port), Connection) as server:
        print(f"TCPIP::127.0.0.1::{server.server_address[1]}::SOCKET", flush=True)
        server.serve_forever()


if __name__ == "__main__":
    main()
