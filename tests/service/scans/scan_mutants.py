"""Ways to break the scan file, done to a running program: ``python scan_mutants.py NAME TEST …`` tests one."""

import sys

import numpy as np
import pytest

from steradian.scans.acquisition import session
from steradian.scans.file import aline_metadata
from steradian.scans.file import writer as store


def acknowledges_beyond():
    """What could not be stored is forgotten, and the next A-lines are acknowledged."""

    def keep(self, batch=()):
        if not batch:
            return True
        if not self._store_patiently(lambda: self._store.append(batch, self._rows)):
            return False
        self._scanner.acknowledge(batch[-1])
        self._note_fired()
        self._control.progress(self._store.stored, self._store.count)
        return True

    session.ScanSession._keep = keep


def acknowledges_unsynchronised():
    """A batch counts as stored once it is written."""
    store.sync_data = lambda handle: None


def remembers_what_was_not_written():
    """The table in memory goes on saying that rows are stored whose write failed."""
    store.ScanFileWriter._forget = lambda self, places, before: None


def checksum_of_samples_only():
    """The row's checksum proves its samples and nothing of its columns."""
    aline_metadata.row_checksums = store.row_checksums = lambda samples, packed: np.asarray(samples, np.uint32)


MUTANTS = {
    each.__name__: each
    for each in (
        acknowledges_beyond,
        acknowledges_unsynchronised,
        remembers_what_was_not_written,
        checksum_of_samples_only,
    )
}

if __name__ == "__main__":
    MUTANTS[sys.argv[1]]()
    sys.exit(pytest.main(["-q", "-rA", "-p", "no:cacheprovider", "-m", "not nightly", *sys.argv[2:]]))
