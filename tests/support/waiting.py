"""Waiting for what becomes true in another thread or process."""

import time


def until(condition, seconds=250.0, tell=lambda: ""):
    """Wait until a condition holds and return what it gave; ``tell`` says more if it never does."""
    deadline = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < deadline, f"it did not happen within {seconds:g} s {tell()}"
        time.sleep(0.02)
    return found
