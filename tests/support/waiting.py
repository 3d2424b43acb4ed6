"""Waiting for what becomes true in another thread or process."""

import time

SHORTEST, LONGEST = 0.02, 0.25
"""Seconds between two looks: a tenth of the time waited so far, within these limits. A look is often a request."""


def until(condition, seconds=250.0, tell=lambda: ""):
    """Wait until a condition holds and return what it gave; ``tell`` says more if it never does."""
    start = time.monotonic()
    while not (found := condition()):
        waited = time.monotonic() - start
        assert waited < seconds, f"it did not happen within {seconds:g} s {tell()}"
        time.sleep(min(max(SHORTEST, waited / 10), LONGEST))
    return found
