import threading

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import inspect, select, text

from steradian.core.exceptions import DamagedFile
from steradian.core.settings import Settings
from steradian.storage.db.database import Database, known_revisions, metadata_url
from steradian.storage.db.tables import Base, MaskRow
from steradian.storage.repositories.masks import MaskRepository


def schema_of(engine):
    """Return all that the database says of its tables."""
    about = inspect(engine)
    return {
        name: {
            "columns": [
                (each["name"], str(each["type"]), each["nullable"], each["default"]) for each in about.get_columns(name)
            ],
            "key": about.get_pk_constraint(name)["constrained_columns"],
            "indexes": sorted((each["name"], each["column_names"], each["unique"]) for each in about.get_indexes(name)),
            "unique": sorted(each["column_names"] for each in about.get_unique_constraints(name)),
            "references": sorted(
                (each["constrained_columns"], each["referred_table"], each["referred_columns"])
                for each in about.get_foreign_keys(name)
            ),
            "checks": sorted(each["sqltext"] for each in about.get_check_constraints(name)),
        }
        for name in Base.metadata.tables
    }


@pytest.mark.parametrize("store", ["embedded", pytest.param("postgres", marks=pytest.mark.long)])
def test_migrations_create_exactly_the_tables_of_the_metadata(store, tmp_path, request):
    """Columns, types, defaults, keys, indexes and constraints are those of ``Base.metadata.create_all``."""
    made = []
    for name, make in (("migrated", Database.migrate), ("direct", lambda one: Base.metadata.create_all(one.engine))):
        embedded = store == "embedded"
        url = f"sqlite:///{tmp_path / name}.sqlite" if embedded else request.getfixturevalue("postgres").database()
        database = Database(url if embedded else metadata_url(Settings.create(data=tmp_path, database_url=url)))
        make(database)
        made.append(schema_of(database.engine))
        if name == "migrated":
            with database.engine.connect() as connection:
                assert compare_metadata(MigrationContext.configure(connection), Base.metadata) == []
        database.close()
    assert made[0] == made[1]


def test_migration_of_tables_of_another_version_is_refused_without_changes(database):
    with database.write() as session:
        session.execute(text("UPDATE alembic_version SET version_num = '9999'"))
    with pytest.raises(DamagedFile, match=r"of a newer version of Steradian.*9999"):
        database.migrate()
    assert database.revision() == "9999"
    assert "9999" not in known_revisions()


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


def test_connection_returned_after_close_is_closed(rows):
    """A thread that ends late does not leave its connection to the server open."""
    late = rows.engine.connect()
    late.execute(text("SELECT 1"))
    used = late.connection.dbapi_connection
    rows.close()
    assert not used.closed
    late.close()
    assert used.closed
