"""Options of a simulator, for command line and library."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

from fabry_perot.simulator.film import RESONANCE_PROFILES, Response
from fabry_perot.simulator.named_phantoms import NAMES
from fabry_perot.wire.constants import MOST_BEAMS

FILMS = {
    "ideal": Response(),
    "real": Response(nonlinear=True, bandwidth=True, directivity=True),
    "nonlinear": Response(nonlinear=True),
    "bandlimited": Response(bandwidth=True),
    "directional": Response(directivity=True),
}
"""Films by name: all shortcomings, none, or one of them."""


@dataclass(frozen=True, slots=True)
class Options:
    """Options of a simulated scanner.

    Parameters
    ----------
    tcp
        ``HOST:PORT`` to listen on (port 0: any free one); ``None`` for a pseudo-terminal.
    link
        Path of a symbolic link to the pseudo-terminal, or ``None``.
    speed
        Device seconds per second.
    seed
        Of noise, pulse energies, film, faults and the phantom.
    noise_db
        Peak signal over rms noise of one shot, in dB; ``inf`` for none.
    phantom
        Name of the object (:data:`fabry_perot.simulator.named_phantoms.NAMES`) or path of a file with one.
    sound_speed
        Of the medium, in m/s.
    baud
        Pace the line like a UART of this baud rate in device time; 0 for unlimited.
    ring
        A-lines the device holds.
    plan_points
        Points the device holds.
    film
        One of :data:`FILMS`. The default, ``"ideal"``, records the phantom's closed-form pressure plus noise.
    relief
        How the film's resonance varies over it, one of :data:`fabry_perot.simulator.film.RESONANCE_PROFILES`.
    tuning_time
        Time in which the interrogation laser tunes, in s.
    gate_rate
        Edges a second at the gate input; 0: there is none.
    beams
        The interrogation beams: ``16`` in a row, or ``4x4`` in rows and columns.
    beam_spacing
        Between neighbouring beams, in m.
    energy_jitter
        Standard deviation of the pulse energy, relative.
    full_scale
        The digitiser's range over the strongest signal; below 1 it clips.
    bit_errors, lost_frames
        Probability that a bit is flipped, that a frame is lost; in both directions.
    repeat
        Compute only so many different A-lines and send them again and again, noise and all: for measuring links, whose
        rate computing A-lines would limit. 0: every shot is its own.
    time_zero
        The digitiser begins so long after the pulse, in s.
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
    plan_points: int = 8192
    film: str = "ideal"
    relief: str = "waves"
    tuning_time: float = 200e-6
    gate_rate: float = 0.0
    beams: str = "1"
    beam_spacing: float = 0.8e-3
    energy_jitter: float = 0.01
    full_scale: float = 2.0
    bit_errors: float = 0.0
    lost_frames: float = 0.0
    repeat: int = 0
    time_zero: float = 0.0
    boot: int | None = None

    def arguments(self) -> list[str]:
        """Return the command-line arguments for these options."""
        words = ["--tcp", self.tcp] if self.tcp else ["--pty", *([self.link] if self.link else [])]
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if value is not None and name not in ("tcp", "link"):
                words.append(f"--{name.replace('_', '-')}={value}")
        return words


def parse(arguments: Sequence[str] | None = None) -> tuple[Options, bool]:
    """Parse the command line; return the options, and whether to end at the end of standard input."""
    parser = argparse.ArgumentParser(
        prog="python -m fabry_perot.simulator",
        description="A simulated Fabry-Perot scanner. Prints one JSON line with its URL when ready. With "
        "--exit-with-stdin it takes JSON commands on standard input, see fabry_perot.simulator.fault_commands.",
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--pty", nargs="?", const="", metavar="LINK", help="pseudo-terminal, linked at LINK")
    where.add_argument("--tcp", metavar="HOST:PORT", help="listen on TCP; port 0 takes any free one")
    add = parser.add_argument
    add("--speed", type=_positive, default=1.0, help="device seconds per second")
    add("--seed", type=int, default=0)
    add("--noise-db", type=float, default=30.0, help="peak signal over rms noise; inf: none")
    add("--phantom", default="yarn", help=f"{', '.join(NAMES)}, or the path of an npz file")
    add("--sound-speed", type=_positive, default=1500.0, help="m/s")
    add("--baud", type=int, default=0, help="pace like a UART; 0: unlimited")
    add("--ring", type=int, default=512, help="A-lines the device holds")
    add("--plan-points", type=int, default=8192, help="points the device holds")
    add("--film", choices=tuple(FILMS), default="ideal", help="which shortcomings the film has; ideal: none")
    add("--relief", choices=RESONANCE_PROFILES, default="waves", help="how the film's resonance varies over it")
    add("--tuning-time", type=_positive, default=200e-6, help="time in which the interrogation laser tunes, in s")
    add("--gate-rate", type=float, default=0.0, help="edges a second at the gate input; 0: there is none")
    add("--beams", type=_beams, default="1", help="interrogation beams: 16 in a row, or 4x4")
    add("--beam-spacing", type=_positive, default=0.8e-3, help="between neighbouring beams, in m")
    add("--energy-jitter", type=float, default=0.01, help="of the pulse energy, relative")
    add("--full-scale", type=_positive, default=2.0, help="digitiser's range over the strongest signal")
    add("--bit-errors", type=_fraction, default=0.0, help="probability of each bit to be flipped, both ways")
    add("--lost-frames", type=_fraction, default=0.0, help="share of frames lost, both ways")
    add("--repeat", type=int, default=0, help="different A-lines, sent over and over; 0: each shot its own")
    add("--time-zero", type=float, default=0.0, help="delay of the digitiser after the pulse, in s")
    add("--boot", type=int, default=None, help="boot id; random by default")
    add("--exit-with-stdin", action="store_true", help="end when standard input closes")
    given = vars(parser.parse_args(arguments))
    exit_with_stdin, link = given.pop("exit_with_stdin"), given.pop("pty")
    return Options(link=link or None, **given), exit_with_stdin


def pattern(beams: str, spacing: float) -> list[tuple[int, int]]:
    """Return offsets (B, 2) of the beams from the first one, in nm: a row or columns × rows, ``spacing`` m apart.

    Raises
    ------
    ValueError
        When ``beams`` is neither, or there are more than a scanner may have.
    """
    columns, _, rows = beams.partition("x")
    step, across, along = round(1e9 * spacing), int(columns), int(rows or "1")
    if not (across >= 1 and along >= 1 and across * along <= MOST_BEAMS):
        raise ValueError(f"{beams}: 1 to {MOST_BEAMS} beams")
    return [(step * column, step * row) for row in range(along) for column in range(across)]


def _beams(text: str) -> str:
    try:
        pattern(text, 1.0)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text}: 1 to {MOST_BEAMS}, in a row (16) or a rectangle (4x4)") from error
    return text


def _positive(text: str) -> float:
    value = float(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text}: must be > 0")
    return value


def _fraction(text: str) -> float:
    value = float(text)
    if not 0 <= value < 1:
        raise argparse.ArgumentTypeError(f"{text}: must be in 0 … 1")
    return value
