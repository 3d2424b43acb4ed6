"""How a simulator is set up: one dataclass for command line and library."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Options:
    """Settings of a simulated scanner.

    Parameters
    ----------
    tcp
        ``HOST:PORT`` to listen on (port 0: any free one); ``None`` for a pseudo-terminal.
    link
        Path of a symbolic link to the pseudo-terminal, or ``None``.
    speed
        Device seconds per second.
    seed
        Of noise, pulse energies and the phantom.
    noise_db
        Peak signal over rms noise of one shot, in dB; ``inf`` for none.
    phantom
        Name of the object; ``"yarn"``.
    sound_speed
        Of the medium, in m/s.
    baud
        Pace the line like a UART of this baud rate in device time; 0 for unlimited.
    ring
        A-lines the device holds.
    boot
        Boot id; ``None`` for a random one.
    """

    tcp: str | None = None
    link: str | None = None
    speed: float = 1.0
    seed: int = 0
    noise_db: float = 30.0
    phantom: str = "yarn"
    sound_speed: float = 1500.0
    baud: int = 0
    ring: int = 512
    boot: int | None = None

    def arguments(self) -> list[str]:
        """Return the command-line arguments that give these settings."""
        words = ["--tcp", self.tcp] if self.tcp else ["--pty", *([self.link] if self.link else [])]
        for name in ("speed", "seed", "noise_db", "phantom", "sound_speed", "baud", "ring", "boot"):
            value = getattr(self, name)
            if value is not None:
                words.append(f"--{name.replace('_', '-')}={value}")
        return words


def parse(arguments: Sequence[str] | None = None) -> tuple[Options, bool]:
    """Return the settings on the command line, and whether to end with standard input."""
    parser = argparse.ArgumentParser(
        prog="python -m fabry_perot.simulator",
        description="A simulated Fabry-Perot scanner. Prints one JSON line with its URL when ready.",
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--pty", nargs="?", const="", metavar="LINK", help="pseudo-terminal, linked at LINK")
    where.add_argument("--tcp", metavar="HOST:PORT", help="listen on TCP; port 0 takes any free one")
    parser.add_argument("--speed", type=_positive, default=1.0, help="device seconds per second")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--noise-db", type=float, default=30.0, help="peak signal over rms noise; inf: none")
    parser.add_argument("--phantom", choices=("yarn",), default="yarn")
    parser.add_argument("--sound-speed", type=_positive, default=1500.0, help="m/s")
    parser.add_argument("--baud", type=int, default=0, help="pace like a UART; 0: unlimited")
    parser.add_argument("--ring", type=int, default=512, help="A-lines the device holds")
    parser.add_argument("--boot", type=int, default=None, help="boot id; random by default")
    parser.add_argument("--exit-with-stdin", action="store_true", help="end when standard input closes")
    given = vars(parser.parse_args(arguments))
    exit_with_stdin, link = given.pop("exit_with_stdin"), given.pop("pty")
    return Options(link=link or None, **given), exit_with_stdin


def _positive(text: str) -> float:
    value = float(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text}: must be > 0")
    return value
