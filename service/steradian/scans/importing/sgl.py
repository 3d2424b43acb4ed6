"""Import of ``.sgl`` files, raw recordings of LabVIEW-controlled Fabry–Pérot scanners.

Big-endian float32 throughout. A header of six numbers: Nx, Ny, Nt, dx (µm), dy (µm), dt (ns); Nx·Ny·Nt samples, x
fastest, then y, then time; up to eight numbers more, those of :data:`TRAILER`. The file's name may carry settings too
(:mod:`steradian.scans.importing.sgl_name`); where both say something, the numbers in the file count. A number that is
not known is NaN in files that Steradian writes.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import DamagedFile, InvalidInput
from steradian.core.quantity_ranges import LENGTH, SAMPLING_INTERVAL
from steradian.scans.file.source_metadata import printable
from steradian.scans.importing.aline_blocks import RawTraceBlocks
from steradian.scans.importing.description import Description
from steradian.scans.importing.geometry import MOST_POINTS
from steradian.scans.importing.import_remarks import remark
from steradian.scans.importing.sgl_name import SglNameMetadata, read_name
from steradian.scans.importing.source import Metadata, RecordingSource, make_source

FORMAT, SUFFIX = "sgl", ".sgl"
KIND = np.dtype(">f4")
HEADER = ("Nx", "Ny", "Nt", "dx", "dy", "dt")
TRAILER = (
    "pulse_index",
    "averages",
    "interrogation_source",
    "cut_off_mhz",
    "excitation_nm",
    "mean_pulse_energy",
    "x0_mm",
    "y0_mm",
)
INTERROGATION = ("Pirelli", "Santec", "Thorlabs")
"""Interrogation lasers by their numbers."""
SPEED = 1500.0
"""Speed of sound in m/s that is assumed, with a remark: the format has no place for one."""
MOST_SAMPLES = 1 << 24
MOST_AVERAGES = 65_535
EXCITATION = (200.0, 3000.0)
"""Wavelengths of light in nm that an excitation laser may have."""


@dataclass(frozen=True)
class Layout:
    """Layout of an .sgl file: counts, steps, interval and trailer.

    Attributes
    ----------
    counts
        Points along x and y.
    samples
        Of an A-line.
    steps
        (dx, dy) in m; that of an axis with one point may be anything.
    interval
        Between samples in s.
    trailer
        The numbers behind the samples, none to eight.
    raw
        The bytes of header and trailer.
    """

    counts: tuple[int, int]
    samples: int
    steps: tuple[float, float]
    interval: float
    trailer: tuple[float, ...]
    raw: bytes

    @property
    def points(self) -> int:
        """Number of A-lines in the file."""
        return self.counts[0] * self.counts[1]

    def said(self, name: str) -> float | None:
        """Return a number of the trailer by name; ``None`` if it is missing or not finite."""
        place = TRAILER.index(name)
        value = self.trailer[place] if place < len(self.trailer) else np.nan
        return value if np.isfinite(value) else None


def is_sgl(path: Path, name: str = "") -> bool:
    """Return whether a file is an .sgl file, by its name or by a header that matches its length."""
    if (name or path.name).lower().endswith(SUFFIX):
        return True
    head, size = _head(path)
    if len(head) < KIND.itemsize * len(HEADER) or size % KIND.itemsize:
        return False
    numbers = _decimal(head)
    whole = all(np.isfinite(number) and number >= 1 and number % 1 == 0 for number in numbers[:3])
    if not whole or not numbers[5] > 0 or not max(numbers[3:5]) > 0:
        return False
    total, held = int(numbers[0]) * int(numbers[1]) * int(numbers[2]), size // KIND.itemsize - len(HEADER)
    return len(TRAILER) < total <= held and held % total <= len(TRAILER)


@contextmanager
def open_sgl(path: Path, said: Description) -> Iterator[RecordingSource]:
    """Open an .sgl file as a recording source.

    Raises
    ------
    DamagedFile
        When its length is not what its header says, or it holds two planes.
    InvalidInput
        When a number of its header is out of range.
    """
    name = printable(said.file_name or path.name)
    named = read_name(name)
    layout = read_layout(path, named)
    with path.open("rb") as file:
        offset = KIND.itemsize * len(HEADER)
        table = RawTraceBlocks(file, offset, KIND, layout.points, layout.samples, time_first=True)
        stated = _stated(layout, named, said)
        yield make_source(FORMAT, table, stated, said, name)


def read_layout(path: Path, named: SglNameMetadata | None = None) -> Layout:
    """Read and validate header and trailer of an .sgl file; raises like :func:`open_sgl`."""
    head, size = _head(path)
    width = KIND.itemsize * len(HEADER)
    if len(head) < width or size % KIND.itemsize:
        raise DamagedFile(f"{path.name} has {size} bytes; an .sgl file has {width} and 4 for each sample")
    numbers = _decimal(head)
    nx, ny, samples = (
        _count(name, number, most)
        for name, number, most in zip(HEADER, numbers, (MOST_POINTS, MOST_POINTS, MOST_SAMPLES), strict=False)
    )
    if nx * ny > MOST_POINTS:
        raise InvalidInput("Nx, Ny", f"{nx} × {ny}", f"at most {MOST_POINTS} points")
    total, held = nx * ny * samples, size // KIND.itemsize - len(HEADER)
    _require_one_plane(path.name, held, total, f"{nx} × {ny} × {samples}", named)
    with path.open("rb") as file:
        file.seek(width + KIND.itemsize * total)
        tail = file.read(KIND.itemsize * len(TRAILER))
    steps = tuple(
        _in_range(name, step / 1e6, f"{step:g} µm", LENGTH) if count > 1 else step
        for name, step, count in zip(("dx", "dy"), numbers[3:5], (nx, ny), strict=True)
    )
    interval = _in_range("dt", numbers[5] / 1e9, f"{numbers[5]:g} ns", SAMPLING_INTERVAL)
    return Layout((nx, ny), samples, (steps[0], steps[1]), interval, tuple(_decimal(tail)), head + tail)


def _head(path: Path) -> tuple[bytes, int]:
    with path.open("rb") as file:
        return file.read(KIND.itemsize * len(HEADER)), os.fstat(file.fileno()).st_size


def _decimal(data: bytes) -> list[float]:
    """Decode float32 numbers to the shortest decimal value: 106.3 rather than 106.30000305."""
    return [float(str(number)) for number in np.frombuffer(data, KIND).astype(np.float32)]


def _count(name: str, number: float, most: int) -> int:
    if not np.isfinite(number) or number % 1 or not 1 <= number <= most:
        raise InvalidInput(name, f"{number:g}", f"a whole number from 1 to {most} in the header of an .sgl file")
    return int(number)


def _in_range(name: str, value: float, given: str, allowed: Any) -> float:
    if value not in allowed:
        raise InvalidInput(name, given, f"{allowed}, in the header of an .sgl file")
    return value


def _require_one_plane(name: str, held: int, total: int, shape: str, named: SglNameMetadata | None) -> None:
    """Raise an error for files of wrong length and for files of two-plane scanners."""
    if named is not None and named.two_planes:
        raise DamagedFile(
            f"{name} is, by its name, a recording of a two-plane (V-shape) scanner; only one plane can be imported: "
            "save each plane as a file of its own (and rename it, if it is one)"
        )
    if held < total:
        raise DamagedFile(f"{name} is truncated: {held} samples, the header states {shape} = {total}")
    times, more = divmod(held, total)
    if held - total > len(TRAILER):
        if times >= 2 and more <= len(TRAILER):
            what = "a two-plane (V-shape) recording, or one of two beams" if times == 2 else f"{times} beams or planes"
            raise DamagedFile(
                f"{name} holds {times} times the {shape} samples of its header: {what}; only one plane with all its "
                "points in the header can be imported"
            )
        raise DamagedFile(
            f"{name} has {held - total} numbers behind its {shape} samples; allowed: at most {len(TRAILER)}"
        )


def _stated(layout: Layout, named: SglNameMetadata, said: Description) -> Metadata:
    _compare(layout, named)
    if named.patterns:
        remark("the name speaks of Hadamard patterns; the samples are taken as those of single points")
    if said.sound_speed is None:
        remark(f"an .sgl file states no speed of sound: {SPEED:g} m/s is assumed where none is given")
    if said.time_zero is None and named.time_zero:
        first = f"{named.time_zero} samples {'after' if named.time_zero > 0 else 'before'}".replace("-", "")
        remark(f"time zero from the file's name, t0[{named.time_zero}]: the first sample was taken {first} the pulse")
    return Metadata(
        points=_points(layout),
        sampling_interval=layout.interval,
        sound_speed=SPEED,
        time_zero=(named.time_zero or 0) * layout.interval,
        excitation=_excitation(layout, named),
        averages=_averages(layout, named),
        details=_details(layout),
    )


def _compare(layout: Layout, named: SglNameMetadata) -> None:
    """Add an import remark for each value that differs between file name and header."""
    for label, figure, value, unit, scale in (
        ("dx", named.dx, layout.steps[0] if layout.counts[0] > 1 else None, "µm", 1e6),
        ("dy", named.dy, layout.steps[1] if layout.counts[1] > 1 else None, "µm", 1e6),
        ("dt", named.dt, layout.interval, "ns", 1e9),
    ):
        if figure is not None and value is not None and not figure.agrees(value):
            words = f"the name states {label} = {scale * figure.value:g} {unit}, the header {scale * value:g} {unit}"
            remark(f"{words}; the header counts")


def _points(layout: Layout) -> NDArray[np.float64]:
    """Return the positions (M, 2) of the points in m, x fastest."""
    lines = []
    for name, count, step in zip(("x0_mm", "y0_mm"), layout.counts, layout.steps, strict=True):
        step, first = step if count > 1 else 0.0, layout.said(name)
        if first is not None and abs(first) > 1e3:
            remark(f"{name[:2]} = {first:g} mm is not a position on a scanner; not used")
            first = None
        lines.append((-(count // 2) * step if first is None else first / 1e3) + step * np.arange(count))
    x, y = lines
    return np.column_stack([np.tile(x, len(y)), np.repeat(y, len(x))])


def _excitation(layout: Layout, named: SglNameMetadata) -> tuple[float, ...]:
    given = layout.said("excitation_nm")
    figure = named.excitation if named.excitation is not None and named.excitation.value > 0 else None
    if given is None or given == 0:  # what the scanner writes where it does not know
        if figure is not None and EXCITATION[0] <= 1e9 * figure.value <= EXCITATION[1]:
            remark(f"excitation wavelength of {1e9 * figure.value:g} nm from the file's name")
            return (figure.value,)
        return ()
    if not EXCITATION[0] <= given <= EXCITATION[1]:
        remark(f"excitation of {given:g} nm is out of {EXCITATION[0]:g} to {EXCITATION[1]:g} nm; not used")
        return ()
    if figure is not None and not figure.agrees(given / 1e9):
        remark(f"the name states {1e9 * figure.value:g} nm, the file {given:g} nm; the file's value is used")
    return (given / 1e9,)


def _averages(layout: Layout, named: SglNameMetadata) -> int:
    given = layout.said("averages")
    if given is None or given == 0:
        if named.averages is not None and 1 <= named.averages <= MOST_AVERAGES:
            return named.averages
        return 1
    if given % 1 or not 1 <= given <= MOST_AVERAGES:
        remark(f"{given:g} averages are not a whole number from 1 to {MOST_AVERAGES}; not used")
        return 1
    if named.averages is not None and named.averages != given:
        remark(f"the name states {named.averages} averages, the file {given:g}; the file's value is used")
    return int(given)


def _details(layout: Layout) -> dict[str, Any]:
    """Return metadata for the scan file's ``source`` attribute, including the bytes of header and trailer."""
    source = layout.said("interrogation_source")
    known = source is not None and source % 1 == 0 and 0 <= source < len(INTERROGATION)
    if source is not None and not known:
        remark(f"interrogation source {source:g} is none of 0 (Pirelli), 1 (Santec), 2 (Thorlabs)")
    energy, cut_off = layout.said("mean_pulse_energy"), layout.said("cut_off_mhz")
    if energy:
        remark(f"mean pulse energy of {energy:g}, kept without a unit: the format states none")
    return {
        "pulse_index": layout.said("pulse_index"),
        "averages": layout.said("averages"),
        "interrogation_source": INTERROGATION[int(source)] if known and source is not None else source,
        "cut_off_hz": None if cut_off is None else cut_off * 1e6,
        "excitation_nm": layout.said("excitation_nm"),
        "mean_pulse_energy": energy,
        "origin_mm": [layout.said("x0_mm"), layout.said("y0_mm")],
        "bytes": layout.raw.hex(),
    }
