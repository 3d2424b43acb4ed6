"""Compiling what a first reconstruction needs, while something else takes its time.

Run as ``python -m steradian.reconstructions.compiling``, it does once, with little data, what reconstructions of scans
do, and ends at once where all that is on disk. Two processors share it, and whoever needs a function that another
process is at waits for that one (:mod:`steradian.compiled`).
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from typing import Final

AHEAD: Final = (sys.executable, "-P", "-m", "steradian.reconstructions.compiling")
SECOND: Final = "second"
"""Argument of who begins with the second half, the depths; the first one is the sensors."""
NICENESS: Final = 5
"""By how much it stands back: a scan that runs meanwhile, and who waits for an image, come first."""


@contextmanager
def compiling_ahead(*half: str) -> Iterator[None]:
    """Have it done by other processes while the block runs; what they have not done by its end is left.

    For our own programs: where Python is part of another one, ``sys.executable`` may be anything.
    """
    try:
        process = _started(*half)
    except OSError:  # no further process is to be had; it is done when it is needed
        yield
        return
    with process:
        try:
            yield
        finally:
            process.kill()


def compile_ahead() -> None:
    """Have it done by other processes, until they are done or this one is gone."""
    with suppress(OSError), _started() as process:
        process.wait()


@contextmanager
def compiling_beside() -> Iterator[None]:
    """Have the second half done by another process while the block, which reconstructs, begins with the first."""
    from steradian.imaging.engines.numba.type1 import type1

    used = bool(type1.signatures)  # in this process
    with nullcontext() if used or not is_needed() else compiling_ahead(SECOND):
        yield


def _started(*half: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [*AHEAD, *half],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # a terminal's Ctrl-C is not meant for it
    )


def is_needed() -> bool:
    """Whether there is a place on disk for it, and something is not there, or not for this processor."""
    from steradian.compiled import is_lacking
    from steradian.imaging.engines.numba import depth, image, type1
    from steradian.reconstructions import halving

    functions = (type1.pack, type1.type1, depth.to_depth, image.to_image, image.close_up, halving.means)
    return any(is_lacking(function) for function in functions)


def compile_all(half: str = "") -> None:
    """Do once what reconstructions of a scan do, in the precision that they have; one half of it first."""
    import numpy as np

    from steradian.imaging import ReconstructionPlan
    from steradian.imaging.engines.numba.engine import NumbaEngine
    from steradian.reconstructions.halving import halved

    positions = np.random.default_rng(0).uniform(-1e-3, 1e-3, (4, 2))  # on no grid
    plan = ReconstructionPlan(positions, samples=40, sampling_interval=8e-9, sound_speed=1500.0, aperture=2e-3, modes=8)
    engine = NumbaEngine(plan.tables, threads=1)
    over_time, over_depth = (np.zeros(size, np.float32) for size in (engine.room.source_size, engine.room.target_size))
    if half != SECOND:
        engine.lateral(np.zeros((4, 40), np.float32))
        engine.to_image(over_depth)
        halved(np.zeros((2, 2, 2), np.float32))
    engine.to_image(engine.to_depth(over_time))
    halved(np.zeros((2, 2, 2), np.float32))


def main(half: str = "") -> None:
    """Be such a process, until it is done or whoever started it is gone."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(OSError, AttributeError):
        os.nice(NICENESS)
    if not is_needed():
        return
    from steradian.imaging.workers import available

    with compiling_ahead(SECOND) if not half and available() > 1 else nullcontext():
        compile_all(half)


def _end_with_parent() -> None:
    while os.read(0, 4096):
        pass
    os._exit(0)


if __name__ == "__main__":
    main(*sys.argv[1:])
