"""Importing in a process of its own, with limits: what a file does to the libraries that read it ends there.

The HDF5 library follows what a damaged file says, sometimes into the ground or in circles, and no care outside it can
prevent that. ``python -P -m steradian.scans.importing.guarded`` reads one request as a line of JSON, writes progress
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
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from steradian.errors import Cancelled, Conflict, DamagedFile, DiskFull, InvalidInput, NotFound, SteradianError
from steradian.progress import IsCancelled, Progress
from steradian.scans.importing import ImportSummary, import_scan
from steradian.scans.layout import sync_folder

MEMORY = 4 << 30
"""Bytes of address space that an import may take beyond what its libraries do."""
SECONDS, SECONDS_PER_MIB = 180.0, 2.0
"""Time on a processor that an import may take, and more of it for each MiB of the file."""
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_PLAIN = {kind.code: kind for kind in (Conflict, DamagedFile, DiskFull, Cancelled)}


def import_guarded(
    source: Path,
    destination: Path,
    *,
    description: Path | None = None,
    progress: Progress | None = None,
    cancelled: IsCancelled | None = None,
    seconds: float = SECONDS,
) -> ImportSummary:
    """Do :func:`~steradian.scans.importing.import_scan` in a process with limited memory and time.

    Parameters
    ----------
    source, destination, description, progress, cancelled
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
        made = _import_in_child(source, draft, description, progress, cancelled, seconds)
        draft.replace(destination)  # here and not in the process, which may be done before it is stopped
        sync_folder(destination.parent)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return dataclasses.replace(made, path=destination)


def _import_in_child(
    source: Path,
    destination: Path,
    description: Path | None,
    progress: Progress | None,
    cancelled: IsCancelled | None,
    seconds: float,
) -> ImportSummary:
    allowed = seconds + SECONDS_PER_MIB * source.stat().st_size / (1 << 20)
    paths = [None if path is None else str(path) for path in (source, destination, description)]
    with subprocess.Popen(
        [sys.executable, "-P", "-m", "steradian.scans.importing.guarded"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=os.environ | dict.fromkeys(THREADS, "1"),
    ) as child:
        try:
            assert child.stdin is not None  # noqa: S101 - asked for above
            assert child.stdout is not None  # noqa: S101
            with suppress(BrokenPipeError):
                child.stdin.write(json.dumps({"paths": paths, "seconds": allowed}).encode() + b"\n")
                child.stdin.flush()
            said = _listen(child.stdout, progress, cancelled)
        finally:
            child.kill()
            child.wait()
    if "result" in said:
        result = said["result"]
        return ImportSummary(destination, result["format"], result["points"], result["samples"])
    if "error" in said:
        raise _error(said["error"])
    raise DamagedFile(f"{source.name} cannot be read: its reader ended {_ending(child.returncode)}")


def _listen(lines: IO[bytes], progress: Progress | None, cancelled: IsCancelled | None) -> dict[str, Any]:
    """Pass on progress; returns the last message, empty when the process ended without one."""
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


def _ending(status: int) -> str:
    if status == -getattr(signal, "SIGXCPU", 0):
        return "at its limit of time"
    return f"by signal {signal.Signals(-status).name}" if status < 0 else f"with exit code {status}"


def main() -> None:
    """Be the process: read a request, limit what it may take, import, say how it went."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches whoever started this, and ends it
    request = json.loads(sys.stdin.readline())
    threading.Thread(target=_end_with_stdin, daemon=True).start()
    said = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)

    def speak(**message: Any) -> None:
        said.write(json.dumps(message) + "\n")
        said.flush()

    def report(stage: str, done: int, total: int) -> None:
        speak(stage=stage, done=int(done), total=int(total))

    limit_process(MEMORY, request["seconds"])
    source, destination, description = (None if path is None else Path(path) for path in request["paths"])
    try:
        made = import_scan(source, destination, description=description, progress=report)  # type: ignore[arg-type]
    except SteradianError as error:
        speak(error=_as_json(error))
    except MemoryError:
        limit = f"{MEMORY / 2**30:g} GiB"
        words = f"{source.name if source else source} needs more than {limit} of memory to be read"
        speak(error={"code": DamagedFile.code, "message": words})
    else:
        speak(result={"format": made.format, "points": made.points, "samples": made.samples})


def limit_process(memory: int, seconds: float) -> None:
    """Let this process take so many bytes more than it has, and so much time on a processor; where the system can."""
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


def _as_json(error: SteradianError) -> dict[str, Any]:
    about: dict[str, Any] = {"code": error.code, "message": str(error)}
    if isinstance(error, InvalidInput):
        about |= {"field": error.field, "value": str(error.value), "allowed": error.allowed}
    if isinstance(error, NotFound):
        about |= {"kind": error.kind, "identifier": error.identifier}
    return about


def _end_with_stdin() -> None:
    while os.read(0, 4096):
        pass
    os._exit(70)


if __name__ == "__main__":
    main()
