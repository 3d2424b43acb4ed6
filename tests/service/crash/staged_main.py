"""A scan in stages that kills its own process: ``staged_main.py PORT FILE run|resume [WHERE]``."""

import os
import signal
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "scans"))
from staged_bench import KnownPlanner, staged_plan

from steradian.scans.acquisition import run, stages
from steradian.scans.acquisition.session_control import SessionControl
from steradian.scans.file import stages as file_stages

BEFORE_FOCUS = {
    "proposed": (KnownPlanner, "next_plan"),
    "decided": (stages, "extend_scan_file"),
    "begun": (file_stages, "_copy_alines"),
    "renamed": (file_stages, "sync_folder"),
}
"""Calls before which the process ends."""
AFTER = {"copied": (file_stages, "_copy_alines"), "made": (stages, "extend_scan_file")}
"""Calls after which it ends."""
WHILE_MEASURING = {"survey": 20, "first shots": 27, "last shots": 50}
"""Numbers of stored A-lines at which it ends."""
PLACES = (*WHILE_MEASURING, *BEFORE_FOCUS, *AFTER)


def die(*_, **__):
    os.kill(os.getpid(), signal.SIGKILL)


class Dying(SessionControl):
    """A control of a session that ends when so many A-lines are stored."""

    def __init__(self, count):
        super().__init__()
        self._count = count

    def progress(self, done, total):
        if done >= self._count:
            die()


def prepare(where):
    if where in BEFORE_FOCUS:
        setattr(*BEFORE_FOCUS[where], die)
    if where in AFTER:
        home, name = AFTER[where]
        real = getattr(home, name)
        setattr(home, name, lambda *args, **options: (real(*args, **options), die()))
    return Dying(WHILE_MEASURING.get(where, 1000))


def main(port, file, how, where=""):
    control, planner, plan = prepare(where), KnownPlanner(), staged_plan(pulse_rate=200.0)
    if how == "run":
        run.run_scan(plan, port, Path(file), control=control, planner=planner)
    else:
        run.resume_scan(Path(file), port, plan=plan, control=control, planner=planner)


if __name__ == "__main__":
    main(*sys.argv[1:])
