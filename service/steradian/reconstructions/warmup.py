"""JIT warm-up: compilation of numba kernels into the disk cache by background processes.

``python -m steradian.reconstructions.warmup``, at the other end of a pipe to its standard input, does once, with
little data, what reconstructions of scans do, and ends at once where all that is on disk, or where another process is
at it. Two processors share it, and whoever needs a function that another process is compiling waits for that one
(:mod:`steradian.core.jit`).
"""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any, Final

from steradian.core.child_process import exit_when_stdin_closes
from steradian.core.sandbox import set_oom_score

WARMUP_COMMAND: Final = (sys.executable, "-P", "-m", "steradian.reconstructions.warmup")
SECOND_HALF: Final = "second"
"""Argument of who begins with the second half, the depths; the first one is the sensors."""
NICENESS: Final = 5
"""By how much it stands back behind a scan that runs meanwhile, where nobody waits for an image yet."""
OOM_SCORE: Final = 500
"""By how much sooner the kernel ends it than others when memory runs out."""
PATIENCE: Final = 1.0
"""Seconds that its end is waited for."""
_log = logging.getLogger(__name__)


@contextmanager
def warmup_in_background(*half: str) -> Iterator[None]:
    """Context manager that compiles kernels in background processes and abandons unfinished ones at its end.

    For our own programs: where Python is part of another one, ``sys.executable`` may be anything.
    """
    process = None
    with suppress(OSError):  # where no further process is to be had it is done when it is needed
        process = _started(*half)
    try:
        yield
    finally:
        if process is not None:
            _end(process)


def warm_up() -> None:
    """Compile kernels in background processes until they finish or this process exits."""
    with suppress(OSError), _started() as process:
        if code := process.wait():
            _log.warning("the kernels of the first reconstruction are not compiled in advance: exit code %d", code)


@contextmanager
def warmup_second_half() -> Iterator[None]:
    """Context manager that compiles half of the kernels in a background process while this one compiles the rest."""
    with warmup_in_background(SECOND_HALF) if _is_wanted() else nullcontext():
        yield


def _is_wanted() -> bool:
    from steradian.imaging.engines.numba.type1 import type1

    if getattr(type1, "signatures", True):  # it has been used in this process
        return False
    try:
        return needs_warmup()
    except Exception as error:  # the reconstruction tells whether that is in its way
        _log.warning("the cache of compiled functions cannot be read: %s", error)
        return False


def _started(*half: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [*WARMUP_COMMAND, *half],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        # a terminal's Ctrl-C is not meant for either; a half is in as much of a hurry as whoever starts it
        start_new_session=not half,
        process_group=0 if half else None,
    )


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    if process.stdin is not None:
        process.stdin.close()
    with suppress(subprocess.TimeoutExpired):  # nobody waits longer for one that hangs in a folder that is gone
        process.wait(PATIENCE)


def _functions() -> list[Any]:
    from steradian.imaging.engines.numba import depth, modes_to_image, type1
    from steradian.reconstructions.volumes import downsample

    return [
        type1.pack,
        type1.type1,
        depth.to_depth,
        modes_to_image.to_image,
        modes_to_image.compact_rows,
        downsample.mean_pool,
    ]


def needs_warmup() -> bool:
    """Return whether a JIT disk cache is available and lacks a kernel for this processor."""
    from steradian.core.jit import is_uncached

    return any(is_uncached(function) for function in _functions())


def warm_up_all(half: str = "") -> None:
    """Compile the reconstruction kernels by running each once; ``half`` limits them to the second half."""
    import numpy as np

    from steradian.imaging import AcquisitionGeometry, Compute, ImageGrid, ReconstructionPlan
    from steradian.imaging.engines.numba.engine import NumbaEngine
    from steradian.reconstructions.volumes.downsample import downsample

    positions = np.random.default_rng(0).uniform(-1e-3, 1e-3, (4, 2))  # on no grid
    geometry = AcquisitionGeometry(positions, 40, dt=8e-9, sound_speed=1500.0, aperture=2e-3)
    plan = ReconstructionPlan(geometry, ImageGrid(8), compute=Compute(device="cpu"))
    engine = NumbaEngine(plan.tables, threads=1)
    over_time, over_depth = (np.zeros(size, np.float32) for size in (engine.room.source_size, engine.room.target_size))
    if half != SECOND_HALF:
        engine.lateral(np.zeros((4, 40), np.float32))
        engine.to_image(over_depth)
        downsample(np.zeros((2, 2, 2), np.float32))
    engine.to_image(engine.to_depth(over_time))
    downsample(np.zeros((2, 2, 2), np.float32))


def main(half: str = "") -> None:
    """Entry point of a background compiling process, which ends when done or when its parent has exited."""
    threading.Thread(target=exit_when_stdin_closes, args=(lambda: os._exit(0),), daemon=True).start()
    set_oom_score(OOM_SCORE)
    if not half:
        _lower_priority()
    from filelock import Timeout

    from steradian.core.jit import cache_lock, is_uncached
    from steradian.imaging.compute.thread_pool import available_threads

    lacking = next((function for function in _functions() if is_uncached(function)), None)
    if lacking is None:
        return
    share = not half and available_threads() > 1
    with (
        suppress(Timeout),
        cache_lock(lacking, half or "first"),
        warmup_in_background(SECOND_HALF) if share else nullcontext(),
    ):
        warm_up_all(half)


def _lower_priority() -> None:
    with suppress(OSError, AttributeError):
        os.nice(NICENESS)
    with suppress(OSError):  # Linux weighs the processes of a session, which it has to itself, against other sessions
        Path("/proc/self/autogroup").write_text(str(NICENESS))


if __name__ == "__main__":
    main(*sys.argv[1:])
