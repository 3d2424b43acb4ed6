"""Latch and database agree on the emergency stop, however a press and a release meet."""

import threading

import pytest

from steradian.api.emergency import EmergencyDesk
from steradian.security.keys import KeyStore
from steradian.storage.database import Database
from steradian.storage.emergency import EmergencyLatch
from steradian.storage.paths import DataDirectory
from steradian.storage.scanners import SCANNER_ID, ScannerRepository

HELD = 1.0
"""Seconds for which one side is held up, or less where the other does not wait for it."""


class HeldUp(ScannerRepository):
    """Where one deed reaches the database late: it gives whoever does not wait for it the time to be done."""

    late = ""

    def __init__(self, database):
        super().__init__(database)
        self.reached, self.other = threading.Event(), threading.Event()

    def stop(self, who, reason):
        return self._do("stop", super().stop, who, reason)

    def release_stop(self, who):
        return self._do("release", super().release_stop, who)

    def _do(self, name, deed, *about):
        if name == self.late:
            self.reached.set()
            self.other.wait(HELD)
            return deed(*about)
        done = deed(*about)
        if self.reached.is_set():
            self.other.set()
        return done


@pytest.fixture
def desk(tmp_path):
    data = DataDirectory(tmp_path)
    data.create()
    database = Database(data.metadata_url)
    database.migrate()
    scanner = HeldUp(database)
    scanner.ensure(simulated=True)
    desk = EmergencyDesk(EmergencyLatch(data.emergency), scanner, KeyStore(database))
    desk.latch, desk.scanner = desk._latch, scanner
    yield desk
    database.close()


def in_thread(act, *about):
    thread = threading.Thread(target=act, args=about)
    thread.start()
    return thread


def is_stopped(desk):
    return desk.scanner.get(SCANNER_ID).stopped_at is not None


def test_a_press_that_is_released_while_it_is_recorded_does_not_stand_in_the_database_for_ever(desk):
    desk.scanner.late = "stop"
    desk.latch.press("Ada", "smoke")
    record = in_thread(desk._record)
    assert desk.scanner.reached.wait(60)
    desk.release("Ben")
    record.join()
    assert desk.standing is None
    assert not is_stopped(desk)


def test_a_press_that_comes_while_another_is_released_stands_in_the_database(desk):
    desk.latch.press("Ada", "smoke")
    desk._record()
    desk.scanner.late = "release"
    release = in_thread(desk.release, "Ben")
    assert desk.scanner.reached.wait(60)
    desk.latch.press("Cid", "fire")
    desk._record()
    release.join()
    assert desk.standing.who == "Cid"
    assert is_stopped(desk)
