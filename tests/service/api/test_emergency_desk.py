"""Latch and database agree on the emergency stop, however a press and a release meet."""

import asyncio
import threading

import pytest

from steradian.api.background import local_emergency_stop as emergency
from steradian.api.background.local_emergency_stop import EmergencyStopController
from steradian.storage.data_dir.emergency_latch import EmergencyLatch, StopOutcome
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database
from steradian.storage.repositories.scanner_lease_and_stop import SCANNER_ID, EmergencyStopped, ScannerRepository
from support.waiting import until

HELD = 1.0
"""Seconds for which one side is held up, or less where the other does not wait for it."""


class HeldUp(ScannerRepository):
    """Where one deed reaches the database late: it gives whoever does not wait for it the time to be done."""

    late = ""

    def __init__(self, database, *about):
        super().__init__(database, *about)
        self.reached, self.other = threading.Event(), threading.Event()

    def stop(self, who, reason, number=None):
        return self._do("stop", super().stop, who, reason, number)

    def release_stop(self, who, reason=None):
        return self._do("release", super().release_stop, who, reason)

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
    desk = EmergencyStopController(EmergencyLatch(data.emergency), scanner)
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
    assert desk.scanner.reached.wait(250)
    desk.release("Ben")
    record.join()
    assert desk.active is None
    assert not is_stopped(desk)


def test_stop_pressed_during_release_remains_in_database(desk):
    desk.latch.press("Ada", "smoke")
    desk._record()
    desk.scanner.late = "release"
    release = in_thread(desk.release, "Ben")
    assert desk.scanner.reached.wait(250)
    desk.latch.press("Cid", "fire")
    desk._record()
    release.join()
    assert desk.active.who == "Cid"
    assert is_stopped(desk)


def test_latch_adopts_stop_from_database_until_released(desk):
    desk._record()
    assert desk.active is None
    desk.scanner.of(SCANNER_ID).stop("Ada", "smoke")
    desk._record()
    assert (desk.active.who, desk.active.reason) == ("Ada", "smoke")
    assert desk.scanner.get(SCANNER_ID).stop_number == desk.active.number, "who sees it elsewhere can release it"
    desk.latch.record_outcome(StopOutcome(desk.active.number, "off", 0.1))
    desk._record()
    row = desk.scanner.get(SCANNER_ID)
    assert (row.stop_number, row.stop_laser, row.stop_seconds) == (desk.active.number, "off", 0.1)
    desk.release("Ben", row.stop_number)
    desk._record()
    assert desk.active is None
    assert not is_stopped(desk)


def test_release_with_older_number_keeps_stop_known_only_to_database(desk):
    desk.latch.press("Ada", "smoke")
    desk._record()
    seen = desk.active.number
    desk.release("Ben", seen)
    desk.scanner.of(SCANNER_ID).stop("Cid", "fire")
    with pytest.raises(EmergencyStopped, match="Cid"):
        desk.release("Ben", seen)
    assert is_stopped(desk)
    assert desk.active.who == "Cid"
    desk.release("Ben", desk.active.number)
    assert not is_stopped(desk)


def test_a_press_that_another_node_brings_again_is_one_press_also_after_its_release(desk, monkeypatch):
    monkeypatch.setattr(emergency, "ANSWER_TIMEOUT", 0.0)
    first, _ = asyncio.run(desk.press("Ada", "smoke", "errand"))
    again, _ = asyncio.run(desk.press("Ada", "smoke", "errand"))
    assert again == first == desk.active
    desk.release("Ben")
    late, _ = asyncio.run(desk.press("Ada", "smoke", "errand"))
    assert (late, desk.active) == (first, None)
    other, _ = asyncio.run(desk.press("Ada", "smoke", "another"))
    assert other == desk.active != first


def test_stop_outcome_is_recorded_in_database_with_response(desk, monkeypatch):
    """Other nodes, and pages that ask them, would say for a while that nobody answers."""
    monkeypatch.setattr(emergency, "ANSWER_TIMEOUT", 250.0)
    monkeypatch.setattr(emergency, "RECORD_INTERVAL", 250.0)
    desk.open()
    try:
        press = in_thread(lambda: asyncio.run(desk.press("Ada", "smoke")))
        until(lambda: is_stopped(desk))
        desk.latch.record_outcome(StopOutcome(desk.active.number, "off", 0.1))
        press.join()
        until(lambda: desk.scanner.get(SCANNER_ID).stop_laser == "off", 100)
    finally:
        desk.close()


def test_press_returns_the_confirmation_that_follows_an_unconfirmed_answer(desk, monkeypatch):
    """The acquisition asks again after 0.25 s: its connection may end just as it is asked first."""
    monkeypatch.setattr(emergency, "ANSWER_TIMEOUT", 250.0)
    monkeypatch.setattr(emergency, "SECOND_LOOK", 250.0)

    async def press():
        pressing = asyncio.create_task(desk.press("Ada", "smoke"))
        await emergency.wait_until(lambda: desk.active is not None, 250.0)
        press = desk.active
        desk.latch.record_outcome(StopOutcome(press.number, "unconfirmed", None, "the port is gone"))
        await asyncio.sleep(0.1)
        desk.latch.record_outcome(StopOutcome(press.number, "off", 0.3, "laser off"))
        return await pressing

    _, deed = asyncio.run(press())
    assert deed.laser == "off"
