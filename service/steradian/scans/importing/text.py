"""Import of text tables (CSV): numbers separated by commas, semicolons, tabs or spaces.

The first line of numbers settles the separator: semicolons before tabs before commas before spaces. A comma inside the
fields of another separator is a decimal comma, in all lines. Lines that begin with # or % are left out, and one heading
of words. Anything else that is not a number, an empty field among them, is refused with its line and field.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import DamagedFile
from steradian.scans.importing.aline_blocks import mapped, temporary_file
from steradian.scans.importing.description import Description
from steradian.scans.importing.import_remarks import remark
from steradian.scans.importing.kwave_p import order_of_square
from steradian.scans.importing.numpy_files import order_in, table_in
from steradian.scans.importing.source import Metadata, RecordingSource, make_source

LINE_BYTES = 16 << 20
SHOWN = 40
"""Characters of a field that a message shows."""
START = 4096
NUMBERS = b"0123456789+-.eE,; \t\r\n"
UTF_16 = (b"\xff\xfe", b"\xfe\xff")
MARK = b"\xef\xbb\xbf"
COMMENTS = (b"#", b"%")
CUT = re.compile(rb"^[+-]?0[0-9]")
"""A whole number with a zero in front: what is left of a decimal that was cut at its comma."""


def is_text_table(path: Path) -> bool:
    """Return whether a file is a text table, by its content (a line of numbers) or its name."""
    with path.open("rb") as file:
        start = file.read(START).removeprefix(MARK)
    if start.startswith(UTF_16):
        return True
    lines = [line for line in start.splitlines() if line.strip() and not line.lstrip().startswith(COMMENTS)]
    if not start.strip() or any(byte < 32 and byte not in b"\t\r\n\f\v" for byte in start):
        return False
    if not lines:  # nothing but comments
        return True
    return path.suffix.lower() in (".csv", ".tsv", ".txt") or any(not line.translate(None, NUMBERS) for line in lines)


@contextmanager
def open_csv(path: Path, said: Description, folder: Path | None = None) -> Iterator[RecordingSource]:
    """Open a text table as a recording source: one A-line per row, or one time step per row if so described.

    Raises
    ------
    DamagedFile, InvalidInput
        When it is damaged or refused, or lacks what is needed.
    """
    with temporary_file(folder) as spare, path.open("rb") as file:
        rows = columns = 0
        for row in text_rows(file, path):
            if columns and len(row) != columns:
                raise DamagedFile(f"{path.name}: row {rows + 1} has {len(row)} numbers, the first has {columns}")
            rows, columns = rows + 1, len(row)
            spare.write(row.tobytes())
        spare.flush()
        if not rows:
            raise DamagedFile(f"{path.name} holds no numbers")
        order = order_in((rows, columns), said, path.name)
        if rows == columns and said.order is None:
            order = order_of_square(mapped(spare, 0, np.dtype(np.float64), (rows, columns)), order)
        table, lateral = table_in(spare, 0, np.dtype(np.float64), (rows, columns), order)
        yield make_source("csv", table, Metadata(), said, path.name, lateral)


def text_rows(file: IO[bytes], path: Path) -> Iterator[NDArray[np.float64]]:
    """Yield the rows of numbers of a text table.

    Raises
    ------
    DamagedFile
        Naming the line and the field that is no finite number.
    """
    form: _Form | None = None
    heading = False
    for number, line in enumerate(iter(lambda: file.readline(LINE_BYTES + 1), b""), 1):
        if len(line) > LINE_BYTES:
            raise DamagedFile(f"{path.name} has a line of more than {LINE_BYTES >> 20} MiB")
        if number == 1 and line.startswith(UTF_16):
            raise DamagedFile(f"{path.name} is UTF-16 text; save it as UTF-8")
        text = line.removeprefix(MARK).strip(b" \r\n")
        if not text.strip() or text.lstrip().startswith(COMMENTS):
            continue
        if form is None and not heading and _is_heading(text):
            heading = True
            remark(f"line {number} was left out as a heading: {_shown(text)}")
            continue
        form = form or _Form.of(text)
        decimal = form.decimal
        yield form.row(text, number, path.name)
        if form.decimal and not decimal:
            remark(f"numbers with decimal commas, from line {number} on; their fields lie between {form.words}")


@dataclass
class _Form:
    """Dialect of a text table: field separator, and whether numbers have decimal commas."""

    separator: bytes | None
    decimal: bool = False

    @property
    def words(self) -> str:
        return {b";": "semicolons", b"\t": "tabs", b",": "commas", None: "spaces"}[self.separator]

    @classmethod
    def of(cls, text: bytes) -> _Form:
        """Return the dialect detected from a line."""
        if b";" in text:
            return cls(b";")
        if b"\t" in text and not all(
            not each.strip() or each.rstrip().endswith(b",") for each in text.split(b"\t")[:-1]
        ):
            return cls(b"\t")
        tokens = text.split()
        if (
            len(tokens) > 1
            and b"," in text
            and all(each.count(b",") <= 1 and each.strip(b",") == each for each in tokens)
        ):
            return cls(None)
        return cls(b"," if b"," in text else None)

    def row(self, text: bytes, number: int, name: str) -> NDArray[np.float64]:
        """Parse the numbers of a line; a comma inside a field marks the table as one with decimal commas."""
        if self.separator is None:
            fields = text.split()
        else:
            fields = [field.strip() for field in text.split(self.separator)]
            if len(fields) > 1 and not fields[-1]:
                fields.pop()  # a separator at the end
        if self.separator != b"," and b"," in text:
            self.decimal = True
            for place, field in enumerate(fields, 1):
                if field.count(b",") > 1 or (b"," in field and b"." in field):
                    raise DamagedFile(
                        f"{name}, line {number}, field {place}: {_shown(field)} has commas beside {self.words}"
                    )
            fields = [field.replace(b",", b".") for field in fields]
        try:
            row = np.array(fields, np.float64)
        except ValueError:
            row = np.array([np.nan])
        if not np.isfinite(row).all():
            raise DamagedFile(f"{name}, line {number}, {_fault(fields)}")
        if self.separator == b"," and b"." not in text:
            self._require_whole(fields, number, name)
        return row

    def _require_whole(self, fields: list[bytes], number: int, name: str) -> None:
        """Raise an error for ambiguous commas: in "0,05" a decimal comma or a separator."""
        for place, field in enumerate(fields, 1):
            if CUT.match(field):
                raise DamagedFile(
                    f"{name}, line {number}, field {place}: {_shown(field)} looks like the end of a decimal comma; "
                    "write points, or semicolons between the numbers"
                )


def _is_heading(text: bytes) -> bool:
    """Return whether a line is a heading: words and no numbers."""
    fields = [field for field in re.split(rb"[,;\t ]+", text.strip()) if field]
    return bool(fields) and not any(_number(field.strip(b"\"'")) is not None for field in fields)


def _number(field: bytes) -> float | None:
    try:
        return float(field)
    except ValueError:
        return None


def _fault(fields: list[bytes]) -> str:
    """Return an error message for the first field that is not a finite number."""
    for place, field in enumerate(fields, 1):
        number = _number(field)
        if not field:
            return f"field {place} is empty"
        if number is None:
            return f"field {place}: {_shown(field)} is not a number"
        if not np.isfinite(number):
            return f"field {place}: {_shown(field)} is not finite"
    return "holds no number"


def _shown(text: bytes) -> str:
    words = text.decode("utf-8", "replace")
    return repr(words if len(words) <= SHOWN else words[:SHOWN] + "…")
