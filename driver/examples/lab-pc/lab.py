"""Example scanner on a lab computer: SCPI laser, DAQ card and digitiser combined and served on a port.

    python lab.py calibrate -o galvo.json                 # the galvo, from a target
    python lab.py serve socket://127.0.0.1:4001 --laser TCPIP::127.0.0.1::5025::SOCKET --galvo galvo.json

All that is made up is in ``bench``. With cards: ``import nidaqmx`` in place of ``Cards(table)``, the digitiser's own
class in place of ``DigitiserCard(table)``, and the marks that a camera saw in place of ``calibration_marks()``.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from bench.cards import Cards, DigitiserCard
from bench.table import DELAY, GATE_EDGES, OpticalTable, calibration_marks
from daq_parts import CounterGatedLaser, DaqGalvo, DigitalLineShutter
from ring_digitiser import RingDigitiser
from scpi_laser import ScpiLaser

from fabry_perot import ComposedInstrument, TuningMap, serve
from fabry_perot.hardware import GalvoCalibration


def build(laser: str, galvo: Path, film: Path | None = None) -> ComposedInstrument:
    """Create the instrument from its components."""
    _, host, port, _ = laser.split("::")
    table = OpticalTable((host, int(port)))
    cards, known = Cards(table), None if film is None else TuningMap.load(film)
    mirrors = DaqGalvo(cards, "Dev1", GalvoCalibration.load(galvo))
    scpi = ScpiLaser(laser, film=known)
    digitiser = RingDigitiser(
        DigitiserCard(table),
        lambda: (mirrors.positions, scpi.wavelength),
        film=known,
        metres_per_pascal=table.shift,  # from a hydrophone's pressure beside the film's
        delay=DELAY,  # from time_zero() of light on the film
    )
    return ComposedInstrument(
        galvo=mirrors,
        laser=scpi,
        digitiser=digitiser,
        excitation=CounterGatedLaser(cards, "Dev1", edges=GATE_EDGES),
        shutter=DigitalLineShutter(cards, "Dev1"),
        model="lab PC with made-up cards",
        serial="LAB-1",
    )


def main() -> None:
    """Run the command line: calibrate the galvo, or serve the scanner."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(required=True, dest="command")
    calibrate = commands.add_parser("calibrate", help="fit the galvo to a target's marks")
    calibrate.add_argument("--degree", type=int, default=3, help="1: affine")
    calibrate.add_argument("-o", "--output", type=Path, default=Path("galvo.json"))
    serving = commands.add_parser("serve", help="be a scanner until Ctrl-C")
    serving.add_argument("port", help="socket://HOST:PORT or a serial port")
    serving.add_argument("--laser", required=True, help="VISA name")
    serving.add_argument("--galvo", type=Path, required=True)
    serving.add_argument("--film", type=Path, help="map of 'fabry-perot tune'")
    given = parser.parse_args()
    if given.command == "calibrate":
        found = GalvoCalibration.fit(*calibration_marks(), degree=given.degree)
        found.save(given.output)
        print(f"degree {found.degree}: marks are met within {1e6 * found.residual:.1f} µm (rms), in {given.output}")
        return
    lab = build(given.laser, given.galvo, given.film)
    serve(lab, given.port, ready=lambda url: print(f"a scanner at {url}", flush=True))


if __name__ == "__main__":
    main()
