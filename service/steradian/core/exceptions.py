"""Exceptions raised on purpose by Steradian, with their base class.

SteradianError
├── InvalidInput      a value is outside its allowed range (also a ``ValueError``)
├── NotFound          no such mask, plan, scan or reconstruction (also a ``LookupError``)
├── Conflict          the request does not fit the present state
│   └── FaultStands       a fault is not cleared while its cause stands
├── DamagedFile       a file is truncated, foreign or of a newer schema
│   └── FolderNotWritable  a part of a data folder belongs to another user, or its file system is read-only
├── DiskFull          the disk cannot hold what is to be written
├── ScanFailed        the scanner or its link gave up; what was acknowledged is kept
│   └── ScanInterrupted   all is well, but the laser may come back only when a person says so
│       └── FaultLatched  the scanner has latched a fault, which a person clears first
├── ScannerUnreachable  the scanner does not answer, or its port cannot be opened
├── StoreUnavailable  the store of scans and results does not answer; trying again may help
└── Cancelled         somebody asked for the operation to stop

Every class has a stable ``code`` which the command line, the HTTP problems and the job log share.
"""

from __future__ import annotations

from typing import ClassVar


class SteradianError(Exception):
    """Base class of all errors raised on purpose."""

    code: ClassVar[str] = "error"


class InvalidInput(SteradianError, ValueError):
    """Error: a value is outside its allowed range.

    Parameters
    ----------
    field
        Name of the parameter, as the caller wrote it.
    value
        What was given (shortened for the message).
    allowed
        The allowed range in words, with units.
    """

    code = "invalid-input"

    def __init__(self, field: str, value: object, allowed: str) -> None:
        self.field, self.value, self.allowed = field, value, allowed
        shown = str(value)
        short = shown if len(shown) <= 80 else f"{shown[:38]}...{shown[-39:]}"  # a path's end says most
        super().__init__(f"{field} is {short}; allowed: {allowed}")

    def __reduce__(self) -> tuple[type[InvalidInput], tuple[str, object, str]]:
        return type(self), (self.field, self.value, self.allowed)


class NotFound(SteradianError, LookupError):
    """Error: no resource of this kind has this identifier."""

    code = "not-found"

    def __init__(self, kind: str, identifier: str) -> None:
        self.kind, self.identifier = kind, identifier
        super().__init__(f"there is no {kind} {identifier!r}")

    def __reduce__(self) -> tuple[type[NotFound], tuple[str, str]]:
        return type(self), (self.kind, self.identifier)


class Conflict(SteradianError):
    """Error: the request is valid but conflicts with the present state."""

    code = "conflict"


class StaleFence(Conflict):
    """Error: a newer attempt of the same job has started, so this attempt's results are discarded."""

    code = "superseded"


class DamagedFile(SteradianError):
    """Error: a file is truncated, not of the expected kind, or of a newer schema."""

    code = "damaged-file"


class FolderNotWritable(DamagedFile):
    """Error: a part of the data folder is not writable (another owner or a read-only file system)."""


class DiskFull(SteradianError):
    """Error: the disk has insufficient space.

    Parameters
    ----------
    needed, available
        Bytes, where they are known: what is needed, and what there is for it.
    """

    code = "disk-full"

    def __init__(self, message: str, *, needed: int | None = None, available: int | None = None) -> None:
        self.needed, self.available = needed, available
        super().__init__(message)


class ScanFailed(SteradianError):
    """Error: the scanner or its link failed; every acknowledged A-line is in the file."""

    code = "scan-failed"


class ScanInterrupted(ScanFailed):
    """Error: the laser or its power was off for too long; only a person can resume the scan."""

    code = "scan-interrupted"


class FaultLatched(ScanInterrupted):
    """Error: the scanner has latched a fault; after a person has cleared it, the scan can be resumed.

    Parameters
    ----------
    code_number
        Number of the fault in the scanner's protocol; 0: the emergency stop.
    message
        What has happened and what to do.
    """

    code = "fault-latched"

    def __init__(self, code_number: int, message: str) -> None:
        self.code_number = code_number
        super().__init__(message)

    def __reduce__(self) -> tuple[type[FaultLatched], tuple[int, str]]:
        return type(self), (self.code_number, str(self))


class FaultStands(Conflict):
    """Error: a latched fault of the scanner cannot be cleared because its cause persists."""

    code = "fault-stands"


class ScannerUnreachable(SteradianError):
    """Error: the scanner does not answer or its port cannot be opened; a retry may succeed."""

    code = "scanner-unreachable"


class StoreUnavailable(SteradianError):
    """Error: the object store does not answer, or does not have an object yet; a retry may succeed."""

    code = "store-unavailable"


class Cancelled(SteradianError):
    """Error that ends an operation which was cancelled by its caller."""

    code = "cancelled"
