"""Scans whose wishes come at stated numbers of A-lines, and what they store."""

import h5py

from steradian.scans.acquisition.session_control import Command, SessionControl

QUIET = {"noise_db": float("inf"), "energy_jitter": 0.0, "ring": 8}
"""A simulator whose A-lines depend on the point alone, and that is never far ahead of its host."""


class Script(SessionControl):
    """Wishes by how many A-lines are stored, and a diary."""

    def __init__(self, *wishes):
        super().__init__()
        self.wishes, self.stored, self.phases = list(wishes), 0, []

    def progress(self, done, total):
        self.stored = done

    def on_phase(self, phase):
        self.phases.append(phase)

    def command(self):
        if self.wishes and self.stored >= self.wishes[0][0]:
            return self.wishes[0][1]
        return Command.RUN


def samples(path):
    with h5py.File(path, "r") as file:
        return file["alines/samples"][:]
