"""One who waits for something in a database looks when somebody has written, and now and then in any case."""

import os
from contextlib import suppress
from pathlib import Path

import pytest

from steradian.storage.db.change_detector import ChangeDetector
from steradian.storage.db.database import Database


@pytest.fixture
def database(tmp_path):
    database = Database(f"sqlite:///{tmp_path / 'steradian ü#.sqlite'}")
    database.migrate()
    yield database
    database.close()


def write(database, value):
    with database.write() as session:
        database.set_fact(session, "test", value)


def test_change_detector_reports_each_commit_once_for_any_writer(database, tmp_path):
    changes = ChangeDetector(database, at_least=1e6)
    assert changes.has_changed(), "what was there before"
    assert not changes.has_changed()
    write(database, "1")
    other = Database(str(database.engine.url))
    write(other, "2")
    assert changes.has_changed()
    assert not changes.has_changed()
    write(other, "3")
    assert changes.has_changed()
    with other.read() as session:
        assert other.get_fact(session, "test") == "3"
    assert not changes.has_changed(), "to read is no change"
    other.close()


def test_change_detector_ignores_rolled_back_transaction(database):
    changes = ChangeDetector(database, at_least=1e6)
    assert changes.has_changed()
    with database.write() as session:
        database.set_fact(session, "test", "1")
        session.flush()
        session.rollback()
    assert not changes.has_changed()


def test_change_detector_reports_change_after_interval_or_for_missing_file(database, tmp_path):
    eager = ChangeDetector(database, at_least=0)
    assert [eager.has_changed() for _ in range(3)] == [True] * 3
    missing = ChangeDetector(Database(f"sqlite:///{tmp_path / 'none' / 'steradian.sqlite'}"), at_least=1e6)
    assert [missing.has_changed() for _ in range(3)] == [True] * 3


@pytest.mark.long
def test_its_connection_goes_with_it(database):
    changes = ChangeDetector(database)
    changes.has_changed()
    path = Path(database.name)
    database.close()  # SQLite closes no file of which another connection holds a lock
    assert opened(path) == 1
    del changes
    assert opened(path) == 0


def opened(path):
    """How often this process has a file open to read only."""
    found = 0
    for link in Path("/proc/self/fd").iterdir():
        with suppress(FileNotFoundError):  # that of the folder itself
            flags = int(Path(f"/proc/self/fdinfo/{link.name}").read_text().split("flags:")[1].split()[0], 8)
            found += link.resolve() == path.resolve() and not flags & (os.O_WRONLY | os.O_RDWR)
    return found


def test_of_a_server_nothing_is_known_without_asking():
    changes = ChangeDetector(Database("postgresql+psycopg://nobody@localhost:9/none"), at_least=1e6)
    assert [changes.has_changed() for _ in range(3)] == [True] * 3
