"""A data folder whose queue lay in a file of its own: its unfinished jobs go on, each once, and that file is left."""

import hashlib
import json
import sqlite3
from contextlib import closing

import pytest
from alembic import command
from alembic.config import Config
from dbos import DBOS, DBOSClient

from steradian.core.settings import Settings
from steradian.storage.db.database import MIGRATIONS, Database, metadata_url
from steradian.storage.db.sqlite_subseconds import with_subseconds
from steradian.storage.state_machines import ReconstructionState, is_terminal
from support.waiting import until

R = ReconstructionState
OPEN = {"number": 1, "worker": "worker-0", "started": "2026-01-01T00:00:00+00:00", "ended": None, "outcome": None}
EARLIER = {  # state, desired state, attempts, whether the engine had been given it
    "waiting": ("queued", "succeeded", [], True),
    "not-given": ("queued", "succeeded", [], False),
    "running": ("running", "succeeded", [OPEN], True),
    "cancelling": ("cancelling", "cancelled", [OPEN], True),
    "over": ("succeeded", "succeeded", [OPEN | {"ended": OPEN["started"], "outcome": "succeeded"}], True),
}


def make_earlier(folder):
    """Write the metadata as of the version before, and the queue's file of the same engine; returns that file."""
    settings, config, file = Settings.create(data=folder), Config(), folder / "queue.sqlite"
    config.set_main_option("script_location", str(MIGRATIONS))
    database = Database(metadata_url(settings))
    with database.engine.execution_options(immediate=True).begin() as connection:
        config.attributes["connection"] = connection
        command.upgrade(config, "0007")
    database.close()
    with closing(sqlite3.connect(folder / "steradian.sqlite")) as connection:
        for name, (state, desired, attempts, given) in EARLIER.items():
            payload = {"do": "succeed", "answer": 1, "diary": str(folder / name)}
            ended = OPEN["started"] if is_terminal(R(state)) else None
            connection.execute(
                "INSERT INTO jobs (id, revision, kind, payload, priority, submitted, state, desired_state, created,"
                " attempt, fence, attempts, done, total, history, ended)"
                " VALUES (?, 1, 'echo', ?, 100, ?, ?, ?, ?, ?, ?, ?, 0, 0, '[]', ?)",
                (name, json.dumps(payload), given, state, desired, OPEN["started"], len(attempts), len(attempts),
                 json.dumps(attempts), ended),
            )  # fmt: skip
        connection.commit()
    url = with_subseconds(f"sqlite:///{file}")
    DBOS.migrate(url)
    client = DBOSClient(system_database_url=url, application_name="steradian")
    for name, (_state, _desired, _attempts, given) in EARLIER.items():
        if given:
            client.enqueue(
                {"workflow_name": "job", "queue_name": "jobs", "workflow_id": name, "app_version": "1"}, name
            )
    client.destroy()
    return file


@pytest.mark.long
def test_unfinished_jobs_of_an_earlier_folder_are_queued_again_and_end_once(tmp_path, make_bench):
    file = make_earlier(tmp_path)
    before = hashlib.sha256(file.read_bytes()).digest()
    bench = make_bench(tmp_path)
    bench.start()

    def over():
        bench.queue.reconcile()
        return all(bench.queue.status(name).is_over for name in EARLIER)

    try:
        until(over)
        jobs = {name: bench.queue.status(name) for name in EARLIER}
    finally:
        bench.close()
    assert {name: str(job.state) for name, job in jobs.items()} == {
        name: "cancelled" if name == "cancelling" else "succeeded" for name in EARLIER
    }
    ends = {name: [e["state"] for e in job.history if is_terminal(R(e["state"]))] for name, job in jobs.items()}
    assert {name: len(end) for name, end in ends.items()} == dict.fromkeys(EARLIER, 1) | {"over": 0}
    starts = {name: len(bench.starts(name)) for name in EARLIER}
    assert starts == {"waiting": 1, "not-given": 1, "running": 1, "cancelling": 0, "over": 0}
    assert [attempt["outcome"] for attempt in jobs["running"].attempts] == ["died", "succeeded"]
    assert hashlib.sha256(file.read_bytes()).digest() == before
