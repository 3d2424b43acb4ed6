"""The API process with a record of what it writes and when the disk has it: ``recorded_api.py RECORD DESCRIPTOR``.

SQLite's own file system layer is wrapped, in the library that Python's ``sqlite3`` uses, so every write, truncation and
synchronisation of a database, its log and the queue's are recorded; so are ``os.fsync`` and ``os.replace`` of files.
What is recorded as written was handed to the system; only after a synchronisation is it on the disk for sure.
"""

import _sqlite3
import ctypes
import os
import pickle
import struct
import sys
from ctypes import CFUNCTYPE, POINTER, c_char_p, c_int, c_int64, c_void_p
from threading import Lock

from steradian.api import __main__ as api

METHODS = 19
"""Of SQLite's table of a file's methods; the first is a version, then xClose, xRead, xWrite, xTruncate, xSync …"""
WRITE, TRUNCATE, SYNC = 3, 4, 5
Write = CFUNCTYPE(c_int, c_void_p, c_void_p, c_int, c_int64)
Truncate = CFUNCTYPE(c_int, c_void_p, c_int64)
Sync = CFUNCTYPE(c_int, c_void_p, c_int)
# Names are passed on as the pointers that they are: SQLite keeps them as long as a file is open.
Open = CFUNCTYPE(c_int, c_void_p, c_void_p, c_void_p, c_int, POINTER(c_int))
Delete = CFUNCTYPE(c_int, c_void_p, c_void_p, c_int)


class FileSystem(ctypes.Structure):
    _fields_ = (
        ("version", c_int),
        ("file_size", c_int),
        ("longest_path", c_int),
        ("next", c_void_p),
        ("name", c_char_p),
        ("data", c_void_p),
        ("open", Open),
        ("delete", Delete),
    )


class Record:
    """A file of pickles, each behind its length; whole ones whatever thread writes."""

    def __init__(self, path):
        self._file, self._lock = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND), Lock()

    def __call__(self, *event):
        body = pickle.dumps(event)
        with self._lock:
            os.write(self._file, struct.pack("<I", len(body)) + body)


def record_sqlite(record):
    library = ctypes.CDLL(_sqlite3.__file__)
    library.sqlite3_vfs_find.restype = POINTER(FileSystem)
    system = library.sqlite3_vfs_find(None).contents
    paths, tables, kept = {}, {}, []
    opened, deleted = Open(ctypes.cast(system.open, c_void_p).value), Delete(ctypes.cast(system.delete, c_void_p).value)

    def wrapped(table):
        """A copy of a table of methods of which three also record."""
        methods = (c_void_p * METHODS).from_buffer_copy((c_void_p * METHODS).from_address(table))
        write, truncate, sync = Write(methods[WRITE]), Truncate(methods[TRUNCATE]), Sync(methods[SYNC])

        def on_write(file, data, length, offset):
            result = write(file, data, length, offset)
            if not result:
                record("write", paths[file], offset, ctypes.string_at(data, length))
            return result

        def on_truncate(file, size):
            result = truncate(file, size)
            record("truncate", paths[file], size)
            return result

        def on_sync(file, flags):
            result = sync(file, flags)
            if not result:
                record("sync", paths[file])
            return result

        for place, function in ((WRITE, Write(on_write)), (TRUNCATE, Truncate(on_truncate)), (SYNC, Sync(on_sync))):
            kept.append(function)
            methods[place] = ctypes.cast(function, c_void_p).value
        kept.append(methods)
        return ctypes.addressof(methods)

    def on_open(vfs, name, file, flags, out):
        result = opened(vfs, name, file, flags, out)
        place = c_void_p.from_address(file)
        if not result and name and place.value:
            paths[file] = ctypes.string_at(name).decode()
            if place.value not in tables:
                tables[place.value] = wrapped(place.value)
            place.value = tables[place.value]
        return result

    def on_delete(vfs, name, durably):
        record("delete", ctypes.string_at(name).decode())
        return deleted(vfs, name, durably)

    kept += [Open(on_open), Delete(on_delete)]
    system.open, system.delete = kept[-2:]
    return kept


def record_files(record):
    fsync, replace = os.fsync, os.replace

    def on_fsync(file):
        fsync(file)
        number = file if isinstance(file, int) else file.fileno()
        path = os.readlink(f"/proc/self/fd/{number}")
        record("file", path, None if os.path.isdir(path) else open(path, "rb").read())

    def on_replace(source, target):
        replace(source, target)
        record("replace", str(source), str(target))

    os.fsync, os.replace = on_fsync, on_replace


if __name__ == "__main__":
    record = Record(sys.argv[1])
    kept = record_sqlite(record)
    record_files(record)
    api.main(int(sys.argv[2]))
