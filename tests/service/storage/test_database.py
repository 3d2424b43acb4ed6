import threading

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import select, text

from steradian.storage.database import Database
from steradian.storage.masks import MaskRepository
from steradian.storage.tables import MaskRow, Table


def test_the_migrations_make_exactly_the_tables_that_the_code_uses(database):
    with database.engine.connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), Table.metadata) == []


def test_migrating_twice_changes_nothing(database, plan):
    MaskRepository(database).put(plan.mask)
    database.migrate()
    assert MaskRepository(database).get(plan.mask.id).count == plan.mask.count


def test_readers_do_not_wait_for_a_writer(database):
    with database.engine.connect() as connection:
        assert connection.scalar(text("PRAGMA journal_mode")) == "wal"
    with database.write() as writer:
        writer.execute(text("DELETE FROM masks"))
        with database.read() as reader:
            assert reader.scalars(select(MaskRow)).all() == []


def test_a_failed_write_leaves_nothing(database, plan):
    masks = MaskRepository(database)
    masks.put(plan.mask)

    def fail():
        with database.write() as session:
            session.execute(text("DELETE FROM masks"))
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert masks.get(plan.mask.id)


def test_two_processes_worth_of_writers_lose_nothing(tmp_path, database):
    def count_up(other):
        for _ in range(50):
            with other.write() as session:
                value = session.scalar(text("SELECT done FROM counter"))
                session.execute(text("UPDATE counter SET done = :v"), {"v": value + 1})
        other.close()

    with database.write() as session:
        session.execute(text("CREATE TABLE counter (done INTEGER)"))
        session.execute(text("INSERT INTO counter VALUES (0)"))
    threads = [threading.Thread(target=count_up, args=(Database(str(database.engine.url)),)) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    with database.read() as session:
        assert session.scalar(text("SELECT done FROM counter")) == 100
