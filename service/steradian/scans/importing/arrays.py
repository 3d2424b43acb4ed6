"""Plain arrays: .npy, .npz and .csv, with a description beside them.

An .npz that holds ``p`` (time, y, z) or (time, y), ``dt`` and ``dy``, ``dz`` (or ``dx`` alone) needs no description: it
is k-Wave's pressure on a full grid of sensors, or on a line of them; k-Wave's lateral axes y and z become our x and y.
"""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from math import prod
from pathlib import Path
from tokenize import TokenError
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from steradian.errors import DamagedFile, InvalidInput
from steradian.scans.importing import names
from steradian.scans.importing.description import Description, grid_points
from steradian.scans.importing.geometry import MOST_POINTS
from steradian.scans.importing.source import Source, Stated, make_source
from steradian.scans.importing.tables import RawTable, Table, scratch, spill
from steradian.scans.importing.untrusted import RATIO, RATIO_FROM, TRACE_BYTES

TRACES = (*names.TRACES, "p")
MOST_MEMBERS = 1000
HEADER_BYTES = 1 << 16
SMALL_BYTES = 256 << 20
LINE_BYTES = 16 << 20
PIECE = 1 << 22


@contextmanager
def open_npy(path: Path, said: Description) -> Iterator[Source]:
    """Open an .npy file of A-lines.

    Raises
    ------
    DamagedFile, InvalidInput
        When it is damaged or refused, or lacks what is needed.
    """
    with path.open("rb") as file:
        shape, kind, fortran = _header(file, path.name)
        if path.stat().st_size - file.tell() != prod(shape) * kind.itemsize:
            raise DamagedFile(f"{path.name} is truncated, or has more than its {shape} numbers")
        points, samples, time_first, lateral = _layout(shape, said, path.name)
        if fortran:
            if len(shape) > 2:
                raise InvalidInput("array", "three axes in Fortran order", "C order, or two axes")
            time_first = not time_first
        table = RawTable(file, file.tell(), kind, points, samples, time_first)
        yield make_source("npy", table, Stated(), said, path.name, lateral)


def read_npy(path: Path) -> NDArray[Any]:
    """Read a small .npy file of numbers.

    Raises
    ------
    DamagedFile
        When it is none, or its length is not what its header says.
    """
    with path.open("rb") as file:
        shape, kind, fortran = _header(file, path.name)
        data = file.read(SMALL_BYTES + 1)
    if len(data) != prod(shape) * kind.itemsize:
        raise DamagedFile(f"{path.name} is truncated, too large, or has more than its {shape} numbers")
    return np.frombuffer(data, kind).reshape(shape, order="F" if fortran else "C")


@contextmanager
def open_npz(path: Path, said: Description, folder: Path | None = None) -> Iterator[Source]:
    """Open an .npz archive with the A-lines as one of its arrays; the others may say what a description would.

    Raises
    ------
    DamagedFile, InvalidInput
        When it is damaged or refused, or lacks what is needed.
    """
    try:
        with zipfile.ZipFile(path) as archive, scratch(folder) as spare:
            held = _members(path, archive)
            name = said.array or next((name for name in TRACES if name in held), None)
            if name is None or name not in held:
                raise DamagedFile(f"{path.name} has no array {name or TRACES[0]!r}; it holds {', '.join(sorted(held))}")
            table, lateral, kwave = _member_table(archive, held[name], said, spare, is_p=name == "p")
            stated = _stated_in(archive, held, said, lateral, simulated=kwave)
            yield make_source("npz", table, stated, said, path.name, lateral)
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, EOFError, UnicodeDecodeError) as error:
        raise DamagedFile(f"{path.name} cannot be read as an .npz archive: {error}") from error


@contextmanager
def open_csv(path: Path, said: Description, folder: Path | None = None) -> Iterator[Source]:
    """Open a text file with an A-line a row, or a time step a row where the description says so.

    Raises
    ------
    DamagedFile, InvalidInput
        When it is damaged or refused, or lacks what is needed.
    """
    with scratch(folder) as spare, path.open("rb") as file:
        rows = columns = 0
        for row in csv_rows(file, path):
            if columns and len(row) != columns:
                raise DamagedFile(f"{path.name}: row {rows + 1} has {len(row)} numbers, the first has {columns}")
            rows, columns = rows + 1, len(row)
            spare.write(row.tobytes())
        spare.flush()
        if not rows:
            raise DamagedFile(f"{path.name} holds no numbers")
        points, samples, time_first, _ = _layout((rows, columns), said, path.name)
        table = RawTable(spare, 0, np.dtype(np.float64), points, samples, time_first)
        yield make_source("csv", table, Stated(), said, path.name)


def _header(file: IO[bytes], name: str) -> tuple[tuple[int, ...], np.dtype[Any], bool]:
    """Read an npy header: shape, kind, Fortran order."""
    try:
        version = npy.read_magic(file)
        read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        width = file.read(2 if version == (1, 0) else 4)
        length = int.from_bytes(width, "little")
        if length > HEADER_BYTES:  # else as much memory as it says is taken before anything is read
            raise DamagedFile(f"{name} has a header of {length} bytes; allowed: at most {HEADER_BYTES}")
        shape, fortran, kind = read(io.BytesIO(width + file.read(length)))
    except (ValueError, EOFError, SyntaxError, TokenError) as error:
        raise DamagedFile(f"{name} is no .npy file: {error}") from error
    if kind.kind not in "iuf" or kind.itemsize > 8:
        raise DamagedFile(f"{name} holds values of the kind {kind}; expected real numbers of at most 8 bytes")
    size = prod(shape) * kind.itemsize
    if any(side < 0 for side in shape) or len(shape) > 3 or not size or size > TRACE_BYTES:
        if shape != ():
            raise DamagedFile(f"{name} has the shape {shape}; expected 1 to 3 axes, at most {TRACE_BYTES:.2g} bytes")
    return shape, kind, bool(fortran)


def _layout(
    shape: tuple[int, ...], said: Description, name: str, default: str = "point, time"
) -> tuple[int, int, bool, tuple[int, ...] | None]:
    """Tell points, samples, whether time comes first, and the points' own axes, from an array's shape."""
    if len(shape) not in (2, 3):
        raise DamagedFile(f"{name} has the shape {shape}; expected points and time")
    time_first = (said.axes or default) == "time, point"
    samples, lateral = (shape[0], shape[1:]) if time_first else (shape[-1], shape[:-1])
    if prod(lateral) > MOST_POINTS:
        raise InvalidInput("points", prod(lateral), f"at most {MOST_POINTS}; is the order of the axes right?")
    return prod(lateral), samples, time_first, lateral


def _members(path: Path, archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    found = archive.infolist()
    if len(found) > MOST_MEMBERS:
        raise DamagedFile(f"{path.name} has {len(found)} members; allowed: at most {MOST_MEMBERS}")
    for member in found:
        if member.flag_bits & 1:
            raise DamagedFile(f"{path.name}: {member.filename} is encrypted")
        if not 0 <= member.header_offset < path.stat().st_size:
            raise DamagedFile(f"{path.name}: {member.filename} would begin at {member.header_offset}")
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise DamagedFile(f"{path.name}: {member.filename} is compressed in a way of its own; allowed: deflate")
        if member.file_size > max(RATIO_FROM, RATIO * member.compress_size):
            raise DamagedFile(
                f"{path.name}: {member.filename} would be {member.file_size} bytes from {member.compress_size}; "
                f"allowed: {RATIO} times as many"
            )
    return {member.filename.removesuffix(".npy"): member for member in found}


def _member_table(
    archive: zipfile.ZipFile, member: zipfile.ZipInfo, said: Description, spare: IO[bytes], *, is_p: bool
) -> tuple[Table, tuple[int, ...] | None, bool]:
    with archive.open(member) as file:
        shape, kind, fortran = _header(file, member.filename)
        if is_p and len(shape) not in (2, 3):
            raise DamagedFile(f"{_name(archive)}: p has shape {shape}; expected (time, y, z) or (time, y)")
        points, samples, time_first, lateral = _layout(
            shape, said, member.filename, "time, point" if is_p else "point, time"
        )
        if fortran and len(shape) > 2:
            raise InvalidInput("array", "three axes in Fortran order", "C order, or two axes")
        table = spill(_pieces(file, kind), spare, points, samples, time_first=time_first != fortran)
    return table, lateral, is_p


def _name(archive: zipfile.ZipFile) -> str:
    return Path(archive.filename or "").name


def _pieces(file: IO[bytes], kind: np.dtype[Any]) -> Iterator[NDArray[Any]]:
    rest = b""
    while data := file.read(PIECE):
        data = rest + data
        whole = len(data) // kind.itemsize * kind.itemsize
        rest = data[whole:]
        yield np.frombuffer(data[:whole], kind)


def _stated_in(
    archive: zipfile.ZipFile,
    held: dict[str, zipfile.ZipInfo],
    said: Description,
    lateral: tuple[int, ...] | None,
    *,
    simulated: bool,
) -> Stated:
    def find(wanted: tuple[str, ...]) -> zipfile.ZipInfo | None:
        return next((held[name] for name in wanted if name in held), None)

    def small(*wanted: str) -> NDArray[Any] | None:
        member = find(wanted)
        return None if member is None else _small(archive, member)

    def number(*wanted: str) -> float | None:
        member = find(wanted)
        if member is None or prod(_shape(archive, member)) != 1:
            return None  # a map of the speed of sound, say; the description may give the number
        return float(_small(archive, member).reshape(-1)[0])

    def time_zero() -> float | NDArray[np.float64]:
        """Of all A-lines, or of each point where there is one for each; none at all is 0."""
        member = find(names.TIME_ZERO)
        if said.time_zero is not None or member is None or prod(_shape(archive, member)) == 1:
            return number(*names.TIME_ZERO) or 0.0
        values = _small(archive, member).astype(np.float64)
        return values.reshape(-1) if values.shape == lateral else values

    points = small(*names.POSITIONS)
    steps = names.LATERAL_STEPS if simulated else (names.STEPS[:1], names.STEPS[1::-1])
    pitches = [next((step for name in wanted if (step := number(name))), None) for wanted in steps]
    if points is None and lateral is not None and (pitch := pitches[0]) is not None:
        points = grid_points(lateral, (pitch, pitches[1] or pitch)[: len(lateral)])
    return Stated(
        points=points,
        weights=None if (weights := small(*names.WEIGHTS)) is None else weights.astype(np.float64).reshape(-1),
        aperture=number(*names.APERTURE),
        sampling_interval=number(*names.INTERVAL),
        sound_speed=number(*names.SPEED),
        time_zero=time_zero(),
        depth=number(*names.DEPTH),
        simulated=simulated,
    )


def _shape(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> tuple[int, ...]:
    with archive.open(member) as file:
        return _header(file, member.filename)[0]


def _small(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    if member.file_size > SMALL_BYTES:
        raise DamagedFile(f"{_name(archive)}: {member.filename} has {member.file_size} bytes; allowed: {SMALL_BYTES}")
    with archive.open(member) as file:
        shape, kind, fortran = _header(file, member.filename)
        data = file.read(prod(shape) * kind.itemsize)
    if len(data) != prod(shape) * kind.itemsize:
        raise DamagedFile(f"{_name(archive)}: {member.filename} is truncated")
    return np.frombuffer(data, kind).reshape(shape, order="F" if fortran else "C")


def csv_rows(file: IO[bytes], path: Path, *, heading: bool = False) -> Iterator[NDArray[np.float64]]:
    """Rows of numbers, with commas, semicolons, tabs or spaces between; lines that begin with # are left out.

    With ``heading`` the first line may be words.
    """
    while line := file.readline(LINE_BYTES + 1):
        if len(line) > LINE_BYTES:
            raise DamagedFile(f"{path.name} has a line of more than {LINE_BYTES >> 20} MiB")
        text = line.strip().removeprefix(b"\xef\xbb\xbf")
        if not text or text.startswith(b"#"):
            continue
        try:
            row = np.array(text.translate(bytes.maketrans(b",;\t", b"   ")).split(), dtype=np.float64)
        except ValueError as error:
            if heading:
                heading = False
                continue
            raise DamagedFile(f"{path.name} is not a table of numbers: {error}") from error
        heading = False
        yield row
