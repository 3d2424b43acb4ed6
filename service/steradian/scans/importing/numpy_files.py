"""Import of NumPy arrays (.npy and .npz), with metadata from a description file.

An .npz that holds ``p`` (time, y, z) or (time, y), ``dt`` and ``dy``, ``dz`` (or ``dx`` alone) needs no description: it
is k-Wave's pressure on a full grid or line of sensors, with ``mask`` at any; its axes y and z become our x and y.
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

from steradian.core.exceptions import DamagedFile, InvalidInput
from steradian.scans.importing import variable_aliases
from steradian.scans.importing.aline_blocks import RawTraceBlocks, TraceBlocks, mapped, spill_to_disk, temporary_file
from steradian.scans.importing.axes import axes_of, table_of
from steradian.scans.importing.description import Description, grid_points
from steradian.scans.importing.geometry import MOST_POINTS
from steradian.scans.importing.import_remarks import remark
from steradian.scans.importing.kwave_p import order_of_p, order_of_square, placing_arrays, require_line
from steradian.scans.importing.mask_arrays import read_mask
from steradian.scans.importing.source import Metadata, RecordingSource, make_source
from steradian.scans.importing.untrusted import RATIO, RATIO_FROM, TRACE_BYTES

TRACES = (*variable_aliases.TRACES, "p")
MAX_MEMBERS = 1000
MOST_AXES = 4
"""Frame, x, y and time."""
HEADER_BYTES = 1 << 16
SMALL_BYTES = 256 << 20
PIECE = 1 << 22


@contextmanager
def open_npy(path: Path, said: Description) -> Iterator[RecordingSource]:
    """Open an .npy file of A-lines as a recording source.

    Raises
    ------
    DamagedFile, InvalidInput
        When it is damaged or refused, or lacks what is needed.
    """
    with path.open("rb") as file:
        shape, kind, fortran = _header(file, path.name)
        if path.stat().st_size - file.tell() != prod(shape) * kind.itemsize:
            raise DamagedFile(f"{path.name} is truncated, or has more than its {shape} numbers")
        order, start = order_in(shape, said, path.name), file.tell()
        if len(shape) == 2 and shape[0] == shape[1] and said.order is None:
            order = order_of_square(mapped(file, start, kind, shape, fortran=fortran), order)
        table, lateral = table_in(file, start, kind, shape, order, fortran=fortran)
        yield make_source("npy", table, Metadata(), said, path.name, lateral)


def read_npy(path: Path) -> NDArray[Any]:
    """Read a small .npy file as an array of numbers.

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
def open_npz(path: Path, said: Description, folder: Path | None = None) -> Iterator[RecordingSource]:
    """Open an .npz archive of A-lines as a recording source; its other arrays can serve as metadata.

    Raises
    ------
    DamagedFile, InvalidInput
        When it is damaged or refused, or lacks what is needed.
    """
    try:
        with zipfile.ZipFile(path) as archive, temporary_file(folder) as spare:
            held = _members(path, archive)
            name = said.array or next((name for name in TRACES if name in held), None)
            if name is None or name not in held:
                raise DamagedFile(f"{path.name} has no array {name or TRACES[0]!r}; it holds {', '.join(sorted(held))}")
            sensors = read_mask(held, lambda each: _small(archive, held[each], "biuf"), said)
            count = 0 if sensors is None else len(sensors.positions)
            table, lateral, kwave = _member_table(archive, held, name, said, spare, count)
            stated = _metadata_of(archive, held, said, lateral, simulated=kwave)
            stated = stated if sensors is None else sensors.applied(stated, table, said)
            placed = sensors is not None or said.positions is not None or said.grid is not None
            by_pitch = kwave and not placed and not any(each in held for each in variable_aliases.POSITIONS)
            if by_pitch and len(lateral) == 1 and stated.points is not None:
                require_line(table, stated, said, float(np.ptp(stated.points)) / max(1, table.points - 1))
            yield make_source("npz", table, stated, said, path.name, lateral)
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, EOFError, UnicodeDecodeError) as error:
        raise DamagedFile(f"{path.name} cannot be read as an .npz archive: {error}") from error


def _header(file: IO[bytes], name: str, kinds: str = "iuf") -> tuple[tuple[int, ...], np.dtype[Any], bool]:
    """Read the header of an .npy file: shape, dtype and Fortran order."""
    try:
        version = npy.read_magic(file)
        read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        width = file.read(2 if version == (1, 0) else 4)
        length = int.from_bytes(width, "little")
        if length > HEADER_BYTES:  # else as much memory as it says is taken before anything is read
            raise DamagedFile(f"{name} has a header of {length} bytes; allowed: at most {HEADER_BYTES}")
        shape, fortran, kind = read(io.BytesIO(width + file.read(length)))
    except (ValueError, EOFError, SyntaxError, TokenError) as error:
        raise DamagedFile(f"{name} is not an .npy file: {error}") from error
    if kind.kind not in kinds or kind.itemsize > 8:
        raise DamagedFile(f"{name} holds values of the kind {kind}; expected real numbers of at most 8 bytes")
    size = prod(shape) * kind.itemsize
    if 0 in shape and len(shape) <= MOST_AXES:
        raise DamagedFile(f"{name} has the shape {shape}: it is empty")
    if any(side < 0 for side in shape) or len(shape) > MOST_AXES or size > TRACE_BYTES:
        allowed = f"1 to {MOST_AXES} axes, at most {TRACE_BYTES:.2g} bytes"
        raise DamagedFile(f"{name} has the shape {shape}; expected {allowed}")
    return shape, kind, bool(fortran)


def order_in(
    shape: tuple[int, ...], said: Description, name: str, default: tuple[str, ...] = ("point", "time"), known: int = 0
) -> tuple[str, ...]:
    """Return the names of an array's axes from the description, else from the default of the format.

    Where the sensors' number is ``known``, or the description states it, and only the other axis of two has so many,
    that is the sensors' axis.
    """
    if said.order is not None:
        return axes_of(said.order, len(shape), name)
    if len(shape) not in (2, 3):
        allowed = 'points and time; of more axes a description gives the names, "axes": "frame, x, y, time"'
        raise DamagedFile(f"{name} has the shape {shape}; expected {allowed}")
    order = axes_of(default, len(shape), name)
    sensors = said.sensors or known
    if len(shape) == 2 and sensors in shape and shape[order.index("point")] != sensors:
        order = order[::-1]
        remark(
            f"the array was taken as ({', '.join(order)}), because {sensors} positions fit its axes in no other order"
        )
    return order


def table_in(
    file: IO[bytes],
    offset: int,
    kind: np.dtype[Any],
    shape: tuple[int, ...],
    order: tuple[str, ...],
    *,
    fortran: bool = False,
) -> tuple[TraceBlocks, tuple[int, ...]]:
    """Return A-lines stored contiguously in a file as a table, with the lengths of the sensor axes."""
    time = order.index("time")
    usual = order in (("point", "time"), ("time", "point"), ("x", "y", "time"), ("time", "x", "y"), ("x", "time"))
    if usual and not (fortran and len(shape) > 2):  # needs no address space
        lateral = tuple(side for axis, side in enumerate(shape) if axis != time)
        if prod(lateral) > MOST_POINTS:
            raise InvalidInput("points", prod(lateral), f"at most {MOST_POINTS}; is the order of the axes right?")
        return RawTraceBlocks(file, offset, kind, prod(lateral), shape[time], (time == 0) != fortran), lateral
    table = table_of(mapped(file, offset, kind, shape, fortran=fortran), order)
    return table, table.lateral


def _members(path: Path, archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    found = archive.infolist()
    if len(found) > MAX_MEMBERS:
        raise DamagedFile(f"{path.name} has {len(found)} members; allowed: at most {MAX_MEMBERS}")
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
    archive: zipfile.ZipFile,
    held: dict[str, zipfile.ZipInfo],
    name: str,
    said: Description,
    spare: IO[bytes],
    sensors: int,
) -> tuple[TraceBlocks, tuple[int, ...], bool]:
    """Return the A-lines of an .npz member, the lengths of its sensor axes, and whether it is k-Wave's ``p``."""
    member, is_p = held[name], name == "p"
    with archive.open(member) as file:
        shape, kind, fortran = _header(file, member.filename)
        if is_p and len(shape) not in (2, 3):
            raise DamagedFile(f"{_name(archive)}: p has shape {shape}; expected (time, y, z) or (time, y)")
        count = prod(shape)
        spill_to_disk(_chunks(file, kind), spare, count, 1, time_first=False)
    known = next((_shape(archive, held[each])[0] for each in variable_aliases.POSITIONS if each in held), sensors)
    guessed = is_p and said.order is None
    is_square = len(shape) == 2 and shape[0] == shape[1] and said.order is None
    order = order_in(shape, said, member.filename, ("time", "point") if is_p else ("point", "time"), known)
    uncounted = not known and not said.sensors
    if guessed and (uncounted or is_square or len(shape) == 3):
        order = order_of_p(mapped(spare, 0, kind, shape, fortran=fortran))
    elif is_square:
        order = order_of_square(mapped(spare, 0, kind, shape, fortran=fortran), order)
    table, lateral = table_in(spare, 0, kind, shape, order, fortran=fortran)
    return table, lateral, is_p


def _name(archive: zipfile.ZipFile) -> str:
    return Path(archive.filename or "").name


def _chunks(file: IO[bytes], kind: np.dtype[Any]) -> Iterator[NDArray[Any]]:
    rest = b""
    while data := file.read(PIECE):
        data = rest + data
        whole = len(data) // kind.itemsize * kind.itemsize
        rest = data[whole:]
        yield np.frombuffer(data[:whole], kind)


def _metadata_of(
    archive: zipfile.ZipFile,
    held: dict[str, zipfile.ZipInfo],
    said: Description,
    lateral: tuple[int, ...] | None,
    *,
    simulated: bool,
) -> Metadata:
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
        """Return the time zero of all A-lines, or one for each point; 0 if the archive has none."""
        member = find(variable_aliases.TIME_ZERO)
        if said.time_zero is not None or member is None or prod(_shape(archive, member)) == 1:
            return number(*variable_aliases.TIME_ZERO) or 0.0
        values = _small(archive, member).astype(np.float64)
        return values.reshape(-1) if values.shape == lateral else values

    points, weights = small(*variable_aliases.POSITIONS), small(*variable_aliases.WEIGHTS)
    steps = variable_aliases.LATERAL_STEPS if simulated else (variable_aliases.STEPS[:1], variable_aliases.STEPS[1::-1])
    pitches = [next((step for name in wanted if (step := number(name))), None) for wanted in steps]
    if points is None and lateral is not None and (pitch := pitches[0]) is not None:
        points = grid_points(lateral, (pitch, pitches[1] or pitch)[: len(lateral)])
    return Metadata(
        points=points,
        weights=None if weights is None else weights.astype(np.float64).reshape(-1),
        aperture=number(*variable_aliases.APERTURE),
        sampling_interval=number(*variable_aliases.INTERVAL)
        or (1 / rate if (rate := number(*variable_aliases.RATE)) else None),
        sound_speed=number(*variable_aliases.SPEED),
        time_zero=time_zero(),
        depth=number(*variable_aliases.DEPTH),
        energies=small(*variable_aliases.ENERGIES),
        simulated=simulated,
        placing=placing_arrays("p" if simulated else said.array or TRACES[0]),
    )


def _shape(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> tuple[int, ...]:
    with archive.open(member) as file:
        return _header(file, member.filename)[0]


def _small(archive: zipfile.ZipFile, member: zipfile.ZipInfo, kinds: str = "iuf") -> NDArray[Any]:
    if member.file_size > SMALL_BYTES:
        raise DamagedFile(f"{_name(archive)}: {member.filename} has {member.file_size} bytes; allowed: {SMALL_BYTES}")
    with archive.open(member) as file:
        shape, kind, fortran = _header(file, member.filename, kinds)
        data = file.read(prod(shape) * kind.itemsize)
    if len(data) != prod(shape) * kind.itemsize:
        raise DamagedFile(f"{_name(archive)}: {member.filename} is truncated")
    return np.frombuffer(data, kind).reshape(shape, order="F" if fortran else "C")
