"""Mutated files of every format that can be imported, each in a forked child of limited memory and time.

    python tests/service/scans/import_fuzz.py 20000 [FORMAT …] [--seed 1] [--keep FOLDER]

A mutated file may be imported or refused. Where the child dies of a file or does not end, as the HDF5 library may with
any, the import as service and command line do it must refuse that file: it is tried at once. Anything else is a find:
another exception, memory beyond the limit, a byte of a file beside it in the result. Finds are printed, kept with
``--keep`` and make the exit status 1.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import resource
import signal
import sys
import tempfile
import time
import zipfile
from collections import Counter
from pathlib import Path
from random import Random

import h5py

sys.path.insert(0, str(Path(__file__).parent))
import foreign

from steradian.core.exceptions import DamagedFile, SteradianError
from steradian.reconstructions.scan_plan_reader import read_stored_plan
from steradian.scans.file.read import read_scan
from steradian.scans.importing import import_scan
from steradian.scans.importing.sandbox import import_in_sandbox

BATCH = 100
MEMORY = 512 << 20
"""Bytes that a child may take beyond what it began with, for files of at most some hundred kilobytes."""
SECONDS = 1
"""Time on a processor for one file; a usual one takes a hundredth."""
SECRET = b"\x3a\x91 nobody who sends a file may see this \xc4\x07"


def npy_plain(folder):
    source, description = foreign.npy_time_first(folder)
    return source, description


def npz_stored(folder):
    """An archive whose members are not compressed, so that changes reach them; the sums of the archive are mended."""
    source, description = foreign.npz_with_positions(folder)
    with zipfile.ZipFile(source) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(source, "w", zipfile.ZIP_STORED) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return source, description


def matlab_5_stored(folder):
    """Without compression, so that changes reach the numbers and what is said of them."""
    from scipy.io import loadmat, savemat

    source, description = foreign.matlab_5(folder)
    savemat(source, {name: value for name, value in loadmat(source).items() if name[0] != "_"})
    return source, description


def with_secret(write, name):
    """Make the writer of a file one of whose datasets lies in a file beside it."""

    def poisoned(folder):
        source, description = write(folder)
        with h5py.File(source, "r+") as file:
            kind, space = file[name].id.get_type(), file[name].id.get_space()
            made = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
            made.set_external(b"secret", 0, file[name].nbytes)
            del file[name]
            group, _, last = name.rpartition("/")
            h5py.h5d.create(file[group or "/"].id, last.encode(), kind, space, made)
        return source, description

    return poisoned


HDF5 = {
    "own": (foreign.own_scan, "alines/shot"),
    "ipasc": (foreign.ipasc_by_pacfish, "binary_time_series_data"),
    "k-wave": (foreign.kwave_index_mask, "p"),
    "matlab-7.3": (foreign.matlab_positions, "sensor_data"),
}
FORMATS = {name: (write, write, write, with_secret(write, secret)) for name, (write, secret) in HDF5.items()} | {
    "matlab-5": (foreign.matlab_5, matlab_5_stored),
    "npy": (npy_plain, foreign.npy_fortran),
    "npz": (foreign.npz_with_positions, npz_stored),
    "csv": (foreign.csv, foreign.csv_time_first),
    "sgl": (foreign.sgl,),
}


def mutate(data: bytes, random: Random) -> bytes:
    """Change a few places: bits, bytes, words of two to eight bytes, spans; more often near the beginning."""
    changed = bytearray(data)
    for _ in range(random.choice((1, 1, 2, 3, 5, 8, 20))):
        if not changed:
            break
        reach = random.choice((128, 1024, 4096, len(changed), len(changed)))
        at = random.randrange(min(reach, len(changed)))
        match random.randrange(8):
            case 0:
                changed[at] ^= 1 << random.randrange(8)
            case 1 | 2:
                changed[at] = random.choice((0, 1, 0x7F, 0x80, 0xFF, random.randrange(256)))
            case 3 | 4:
                size = random.choice((2, 4, 8))
                word = random.choice((0, 1, (1 << 8 * size) - 1, 1 << (8 * size - 1), random.getrandbits(8 * size)))
                changed[at : at + size] = word.to_bytes(size, "little")
            case 5:
                changed[at : at + random.randrange(64)] = random.randbytes(random.randrange(64))
            case 6:
                other = random.randrange(len(changed))
                span = random.randrange(1, 256)
                changed[at : at + span] = changed[other : other + span]
            case 7 if random.random() < 0.3:
                del changed[at:]
    if data[:2] == b"PK" and random.random() < 0.5:
        return _mended(bytes(changed), data)
    return bytes(changed)


def _mended(changed: bytes, data: bytes) -> bytes:
    """An archive of the old one's members with the bytes that now lie in their places, with right checksums."""
    made = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as new:
        for member in old.infolist():
            if member.compress_type != zipfile.ZIP_STORED:
                return changed
            start = member.header_offset + 30 + len(member.filename)
            new.writestr(member.filename, changed[start : start + member.file_size])
    return made.getvalue()


def child(folder: Path, bases: list[tuple[bytes, str, Path | None]], numbers: range, seed: str, out: int) -> None:
    """Import mutated files one after the other; say which before and how it went after."""
    grown = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (grown + MEMORY,) * 2)
    os.chdir(folder)
    for number in numbers:
        random = Random(f"{seed}/{number}")
        data, name, description = bases[number % len(bases)]
        source, scan = folder / name, folder / "scan.h5"
        source.write_bytes(mutate(data, random))
        scan.unlink(missing_ok=True)
        os.write(out, json.dumps({"number": number}).encode() + b"\n")
        signal.setitimer(signal.ITIMER_PROF, SECONDS)  # its signal ends the process
        os.write(out, json.dumps({"number": number, "end": attempt(source, scan, description)}).encode() + b"\n")


def attempt(source: Path, scan: Path, description: Path | None) -> str:
    """Import a file and read what came of it; returns ``imported``, ``refused`` or what is wrong."""
    try:
        import_scan(source, scan, description=description)
    except SteradianError as error:
        if str(source.parent) in str(error):
            return f"a folder in the message: {error}"
        return "left something" if scan.exists() else "refused"
    except BaseException as error:
        return f"{type(error).__name__}: {error}"[:300]
    try:
        if SECRET[:16] in scan.read_bytes():
            return "a secret came out"
        read_stored_plan(scan)
        read_scan(scan)
    except SteradianError as error:
        if "no A-line" not in str(error):
            return f"imported and then {error}"[:300]
    except BaseException as error:
        return f"imported and then {type(error).__name__}: {error}"[:300]
    return "imported"


def fuzz(name: str, count: int, seed: int, keep: Path | None = None) -> Counter[str]:
    """Mutate ``count`` files of a format; returns how often each end was seen."""
    ends: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="import-fuzz-") as top:
        folder, bases = Path(top), []
        for index, write in enumerate(FORMATS[name]):
            here = folder / str(index)
            here.mkdir()
            source, description = write(here)
            bases.append((source.read_bytes(), source.name, description))
        work = folder / "work"
        work.mkdir()
        (work / "secret").write_bytes(SECRET * 1000)
        start = 0
        while start < count:
            numbers = range(start, min(start + BATCH, count))
            start = _batch(name, work, bases, numbers, f"{seed}/{name}", ends, keep)
    return ends


def _batch(name, work, bases, numbers, seed, ends, keep) -> int:
    """Run one child; returns the number after the last one that it dealt with."""
    read, write = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(read)
        status = 1
        try:
            child(work, bases, numbers, seed, write)
            status = 0
        finally:
            os._exit(status)
    os.close(write)
    begun = numbers.start
    with os.fdopen(read) as lines:
        for line in lines:
            told = json.loads(line)
            begun = told["number"]
            if "end" in told:
                _count(name, begun, told["end"], work, bases, seed, ends, keep)
                begun += 1
    _, status = os.waitpid(pid, 0)
    if begun == numbers.stop:
        return begun
    ends[f"ended by {signal.Signals(os.WTERMSIG(status)).name}" if os.WIFSIGNALED(status) else "exited"] += 1
    _, base, description = bases[begun % len(bases)]
    try:
        import_in_sandbox(work / base, work / "scan.h5", description=description, seconds=SECONDS)
        end = "read by the guarded process and by no other"
    except DamagedFile:
        end = "refused"
    except BaseException as error:
        end = f"guarded: {type(error).__name__}: {error}"
    _count(name, begun, end, work, bases, seed, ends, keep)
    return begun + 1


def _count(name, number, end, work, bases, seed, ends, keep) -> None:
    if end in ("imported", "refused"):
        ends[end] += 1
        return
    ends["find"] += 1
    print(f"{name} {number}: {end}", flush=True)
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
        data = bases[number % len(bases)][0]
        (keep / f"{name}-{number}").write_bytes(mutate(data, Random(f"{seed}/{number}")))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", type=int, help="mutated files a format")
    parser.add_argument("formats", nargs="*", default=list(FORMATS), help=", ".join(FORMATS))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder for finds")
    wanted = parser.parse_args()
    found = 0
    for name in wanted.formats:
        begun = time.monotonic()
        ends = fuzz(name, wanted.count, wanted.seed, wanted.keep)
        found += ends["find"]
        print(json.dumps({name: ends | {"files": wanted.count, "s": round(time.monotonic() - begun)}}), flush=True)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
