"""The real acquisition process, whose disk is full while DATA/full exists and which keeps a diary of every A-line it
acknowledged: a line ``file row checksum`` each, written after the acknowledgement."""

import errno
import os
from pathlib import Path

import google_crc32c

import fabry_perot
from steradian.runtime import acquisition
from steradian.scans.acquisition import session
from steradian.scans.file.writer import ScanFileWriter

DATA = Path(os.environ["STERADIAN_DATA"])
FULL = DATA / "full"
diary = os.open(DATA / "diary", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
pending = []
append, overwrite, acknowledge = ScanFileWriter.append, ScanFileWriter._overwrite, fabry_perot.Scanner.acknowledge


def note_append(store, alines, rows=None):
    append(store, alines, rows)
    pending[:] = [
        (store.path.name, int(rows[line.point]), google_crc32c.value(line.samples.tobytes())) for line in alines
    ]


def note_acknowledge(scanner, aline):
    acknowledge(scanner, aline)
    os.write(diary, "".join(f"{name} {row} {crc}\n" for name, row, crc in pending).encode())
    pending.clear()


def write(store, offset, data):
    if FULL.exists():
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    overwrite(store, offset, data)


ScanFileWriter.append, ScanFileWriter._overwrite = note_append, write
fabry_perot.Scanner.acknowledge = note_acknowledge
session.RETRY_INTERVAL = 0.2

if __name__ == "__main__":
    acquisition.main()
