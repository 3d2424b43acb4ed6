"""Import in a sandboxed subprocess with limits of memory and time.

The HDF5 library follows what a damaged file says, sometimes into the ground or in circles, and no care outside it can
prevent that. ``python -P -m steradian.scans.importing.sandbox`` reads one request as a line of JSON, writes progress
and the end as such lines, and dies with whoever started it. Without ``-P`` Python would look for modules in the current
folder first, which may be the one that the file came in.
"""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, Literal

from steradian.core.atomic_files import sync_folder
from steradian.core.child_process import describe_exit, exit_when_stdin_closes
from steradian.core.exceptions import Cancelled, Conflict, DamagedFile, DiskFull, InvalidInput, NotFound, SteradianError
from steradian.core.progress import CancelCheck, Progress
from steradian.core.sandbox import minimal_environment, restrict_filesystem, set_oom_score
from steradian.scans.importing import ImportSummary, import_scan
from steradian.scans.importing.description import read_description
from steradian.scans.importing.inspect import RecordingSummary, inspect_recording
from steradian.scans.importing.source import MissingField

MEMORY = 4 << 30
"""Bytes of address space that an import may take beyond what its libraries do."""
SECONDS, SECONDS_PER_MIB = 180.0, 2.0
"""Time on a processor that an import may take, and more of it for each MiB of the file."""
POLL_INTERVAL = 20.0
"""The same for a look into a file."""
SPARE_BYTES = 100 << 20
"""Bytes of the disk that an import leaves free."""
OPEN_FILES = 64
LOG_TAIL = 1000
"""The highest score by which the kernel chooses whom to end when memory runs out."""
COMMAND = (sys.executable, "-P", "-m", "steradian.scans.importing.sandbox")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_PLAIN = {kind.code: kind for kind in (Conflict, DamagedFile, DiskFull, Cancelled)}


def import_in_sandbox(
    source: Path,
    destination: Path,
    *,
    description: Path | None = None,
    options: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
    seconds: float = SECONDS,
) -> ImportSummary:
    """Run :func:`~steradian.scans.importing.import_scan` in a sandboxed process with limits of memory and time.

    Parameters
    ----------
    source, destination, description, options, progress, cancelled
        As there.
    seconds
        Time on a processor for a small file.

    Raises
    ------
    DamagedFile
        Also when the process reached a limit or died: a file that does that to its reader counts as damaged.
    SteradianError
        What :func:`~steradian.scans.importing.import_scan` raises.
    """
    if not source.is_file():
        raise NotFound("file", str(source))
    if destination.exists():
        raise Conflict(f"{destination} exists; choose another name or remove it")
    destination.parent.mkdir(parents=True, exist_ok=True)
    folder = destination.with_name(f"{destination.name}.importing")
    shutil.rmtree(folder, ignore_errors=True)  # of an import that was killed
    folder.mkdir()
    try:
        draft = folder / destination.name
        made = _in_child("import", source, draft, description, progress, cancelled, seconds, options)
        if draft.is_symlink() or not draft.is_file():
            raise DamagedFile(f"{source.name} cannot be read: its reader left no file")
        draft.replace(destination)  # here and not in the process, which may be done before it is stopped
        sync_folder(destination.parent)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return ImportSummary(destination, made["format"], made["points"], made["samples"], tuple(made["notes"]))


def inspect_in_sandbox(
    source: Path, folder: Path, *, description: Path | None = None, seconds: float = POLL_INTERVAL
) -> RecordingSummary:
    """Run :func:`~steradian.scans.importing.inspect.inspect_recording` in a sandboxed, limited process.

    Parameters
    ----------
    source, description
        As there.
    folder
        Where it may write.
    seconds
        Time on a processor for a small file.

    Raises
    ------
    DamagedFile
        Also when the process reached a limit or died.
    SteradianError
        What :func:`~steradian.scans.importing.inspect.inspect_recording` raises.
    """
    result = _in_child("look", source, folder / "none", description, None, None, seconds)
    return RecordingSummary(**result | {"missing": [MissingField(**one) for one in result["missing"]]})


def _in_child(
    task: Literal["import", "look"],
    source: Path,
    destination: Path,
    description: Path | None,
    progress: Progress | None,
    cancelled: CancelCheck | None,
    seconds: float,
    options: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    allowed = seconds + SECONDS_PER_MIB * source.stat().st_size / (1 << 20)
    paths = [None if path is None else str(path.absolute()) for path in (source, destination, description)]
    free = max(0, shutil.disk_usage(destination.parent).free - SPARE_BYTES)
    request = {"task": task, "paths": paths, "seconds": allowed, "bytes": free, "options": dict(options or {})}
    with subprocess.Popen(
        COMMAND,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        cwd=destination.parent,
        env=minimal_environment(os.environ, destination.parent) | dict.fromkeys(THREADS, "1"),
    ) as child:
        try:
            assert child.stdin is not None  # noqa: S101 - asked for above
            assert child.stdout is not None  # noqa: S101
            with suppress(BrokenPipeError):
                child.stdin.write(json.dumps(request).encode() + b"\n")
                child.stdin.flush()
            said = _listen(child.stdout, progress, cancelled)
        finally:
            child.kill()
            child.wait()
    if "result" in said:
        result: dict[str, Any] = said["result"]
        return result
    if "error" in said:
        raise _error(said["error"])
    limit = child.returncode == -getattr(signal, "SIGXCPU", 0)
    end = "at its limit of time" if limit else describe_exit(child.returncode)
    raise DamagedFile(f"{source.name} cannot be read: its reader ended {end}")


def _listen(lines: IO[bytes], progress: Progress | None, cancelled: CancelCheck | None) -> dict[str, Any]:
    """Report the process's progress messages to the caller; return its last message, empty without one."""
    for line in lines:
        said: dict[str, Any] = json.loads(line)
        if "stage" not in said:
            return said
        if cancelled and cancelled():
            raise Cancelled(f"the import was stopped at {said['done']} of {said['total']} {said['stage']}")
        if progress:
            progress(said["stage"], said["done"], said["total"])
    return {}


def _error(said: dict[str, Any]) -> SteradianError:
    match said:
        case {"code": InvalidInput.code, "field": str(field), "value": value, "allowed": str(allowed)}:
            return InvalidInput(field, value, allowed)
        case {"code": NotFound.code, "kind": str(kind), "identifier": str(identifier)}:
            return NotFound(kind, identifier)
        case _:
            return _PLAIN.get(said["code"], SteradianError)(said["message"])


def main() -> None:
    """Entry point of the import process: read a request, set resource limits, import, report the outcome."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches whoever started this, and ends it
    request = json.loads(sys.stdin.readline())
    source, destination, description = (None if path is None else Path(path) for path in request["paths"])
    assert source is not None  # noqa: S101 - only a description may be missing
    assert destination is not None  # noqa: S101
    set_oom_score(LOG_TAIL)
    if not restrict_filesystem(_needed(source, description), destination.parent):
        sys.stderr.write("no Landlock here: the reader of this file can read all files of its user\n")
    threading.Thread(target=exit_when_stdin_closes, args=(lambda: os._exit(70),), daemon=True).start()
    said = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)

    def speak(**message: Any) -> None:
        said.write(json.dumps(message) + "\n")
        said.flush()

    def report(stage: str, done: int, total: int) -> None:
        speak(stage=stage, done=int(done), total=int(total))

    limit_process(MEMORY, request["seconds"], request["bytes"])
    try:
        if request["task"] == "look":
            found = dataclasses.asdict(inspect_recording(source, description, destination.parent))
        else:
            made = import_scan(
                source, destination, description=description, options=request["options"], progress=report
            )
            found = {"format": made.format, "points": made.points, "samples": made.samples, "notes": made.notes}
    except SteradianError as error:
        speak(error=_as_json(error))
    except MemoryError:
        limit = f"{MEMORY / 2**30:g} GiB"
        words = f"{source.name} needs more than {limit} of memory to be read"
        speak(error={"code": DamagedFile.code, "message": words})
    else:
        speak(result=found)


def _needed(source: Path, description: Path | None) -> list[Path]:
    """Return the files that an import reads: recording, description and the positions file."""
    if description is None:
        return [source]
    with suppress(SteradianError):  # it is told when the description is read
        if isinstance(name := read_description(description).positions, str):
            return [source, description, description.parent / name]
    return [source, description]


def limit_process(memory: int, seconds: float, size: int) -> None:
    """Set resource limits of this process (memory, processor time, file size) where the system supports them.

    Parameters
    ----------
    memory
        Bytes of address space beyond what it has.
    seconds
        Time on a processor beyond what it has used.
    size
        Bytes of each file it writes.
    """
    with suppress(ImportError, OSError, ValueError):
        import resource

        pages = int(Path("/proc/self/statm").read_text().split()[0])
        resource.setrlimit(resource.RLIMIT_AS, (pages * os.sysconf("SC_PAGE_SIZE") + memory,) * 2)
    with suppress(ImportError, OSError, ValueError):
        import resource

        used = resource.getrusage(resource.RUSAGE_SELF)
        end = int(used.ru_utime + used.ru_stime + seconds) + 1
        resource.setrlimit(resource.RLIMIT_CPU, (end, end + 5))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
        resource.setrlimit(resource.RLIMIT_NOFILE, (OPEN_FILES, OPEN_FILES))
        resource.setrlimit(resource.RLIMIT_NPROC, (0, 0))  # of no more threads, either; root is not bound by it


def _as_json(error: SteradianError) -> dict[str, Any]:
    about: dict[str, Any] = {"code": error.code, "message": str(error)}
    if isinstance(error, InvalidInput):
        about |= {"field": error.field, "value": str(error.value), "allowed": error.allowed}
    if isinstance(error, NotFound):
        about |= {"kind": error.kind, "identifier": error.identifier}
    return about


if __name__ == "__main__":
    main()
