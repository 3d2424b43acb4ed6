"""Everything is killed, one after another and at random, while jobs come and a scan runs: nothing is lost or doubled.

A short run by default; STERADIAN_CLUSTER_SECONDS=300 makes it five minutes and 200 jobs.
"""

import os
import random
import threading
import time
import uuid
from collections import Counter
from contextlib import suppress
from datetime import timedelta

import httpx
import pytest
from sqlalchemy import select

from fabry_perot.simulator import launch
from steradian.core.settings import Settings
from steradian.storage.blobs.object_store import S3BlobStore
from steradian.storage.blobs.outdated_scan_copy import is_stale
from steradian.storage.db.database import Database, metadata_url
from steradian.storage.db.tables import ScanRow
from support.cluster import Cluster
from support.waiting import until

SECONDS = float(os.environ.get("STERADIAN_CLUSTER_SECONDS", "30"))
JOBS = max(10, round(200 * SECONDS / 300))
WORKERS = 3
PATIENCE = 900.0
"""Seconds within which all that was asked for must have ended: a busy machine starts nodes slowly."""
pytestmark = [pytest.mark.soak, pytest.mark.timeout(SECONDS + 3 * PATIENCE)]
OVER = {"succeeded", "failed", "cancelled"}


class Killer:
    """Kills one thing after another and starts it again, until time is up."""

    def __init__(self, cluster, postgres, seaweed, seed):
        self.random, self.killed, self.error = random.Random(seed), Counter(), None
        self._over = threading.Event()
        api = {"API node": [cluster.first, cluster.second], "acquisition": list(cluster.scanners.values())}
        self._nodes = api | {"worker": cluster.workers}
        self._servers = {"database": (postgres.kill, postgres.start), "store": (seaweed.stop, seaweed.start)}
        self._thread = threading.Thread(target=self._run)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._over.set()
        self._thread.join()
        if self.error is not None:
            raise self.error

    def _run(self):
        deadline = time.monotonic() + SECONDS
        kinds = [*self._nodes, *self._servers]
        self.random.shuffle(kinds)
        try:
            while time.monotonic() < deadline or len(self.killed) < len(kinds):  # each kind once at least
                kind = kinds[self.killed.total() % len(kinds)] if len(self.killed) < len(kinds) else None
                self._kill(kind or self.random.choice(kinds))
                if self._over.wait(self.random.uniform(0.5, 3.0)):
                    return
        except BaseException as error:
            self.error = error

    def _kill(self, kind):
        self.killed[kind] += 1
        away = self.random.uniform(0.2, 3.0)
        if kind in self._servers:
            stop, start = self._servers[kind]
            stop()
            time.sleep(away)
            start()
            return
        node = self.random.choice(self._nodes[kind])
        node.kill()
        time.sleep(away)
        node.start()


class Client:
    """Somebody who asks any API node, and again until there is an answer."""

    def __init__(self, cluster, seed):
        self._random, self._urls = (
            random.Random(seed),
            [f"{node.url}/api/v1" for node in (cluster.first, cluster.second)],
        )
        self.unanswered = Counter()

    def ask(self, method, path, **how):
        """Return the answer, the first one that is no failure of the service."""
        deadline = time.monotonic() + PATIENCE
        while True:
            with suppress(httpx.HTTPError):
                answer = httpx.request(method, f"{self._random.choice(self._urls)}{path}", timeout=20, **how)
                if answer.status_code < 500:
                    return answer
                self.unanswered[answer.status_code] += 1
            assert time.monotonic() < deadline, f"{method} {path} is not answered"
            time.sleep(0.2)

    def get(self, path):
        return self.ask("GET", path).raise_for_status().json()

    def make(self, path, **body):
        answer = self.ask("POST", path, json=body, headers={"Idempotency-Key": uuid.uuid4().hex})
        assert answer.status_code in {200, 201, 202}, answer.text
        return answer.json()

    def watch(self, scan_id):
        """Have a scan go on whenever it is interrupted; returns what was stored at each look, once it is over."""
        stored, deadline = [0], time.monotonic() + SECONDS + PATIENCE
        while (scan := self.get(f"/scans/{scan_id}"))["state"] not in {"complete", "partial", "aborted", "failed"}:
            assert time.monotonic() < deadline, scan
            if scan["state"] == "interrupted":
                self.ask("PUT", f"/scans/{scan_id}/desired-state", json={"state": "running"})
            with suppress(httpx.HTTPStatusError, KeyError):  # it may have no file yet
                stored.append(self.get(f"/scans/{scan_id}/coverage")["stored"])
            time.sleep(0.5)
        return scan, stored


def test_jobs_and_scan_finish_exactly_once_under_random_kills(tmp_path, postgres, seaweed, capsys):
    seed = int(os.environ.get("STERADIAN_CLUSTER_SEED", random.randrange(2**32)))
    with (
        launch(tcp="127.0.0.1:0") as laser,
        Cluster(tmp_path, postgres, seaweed, {"scanner-0": laser.url}, workers=WORKERS) as cluster,
    ):
        client = Client(cluster, seed)
        base = client.make("/plans", mask_id=grid(client, 8), samples=256, pulse_rate=100)["id"]
        first, _ = client.watch(client.make("/scans", plan_id=base)["id"])
        assert first["state"] == "complete", first
        slow = client.make("/plans", mask_id=grid(client, round((10 * SECONDS) ** 0.5)), samples=256, pulse_rate=10)[
            "id"
        ]
        scan, seen, watched = client.make("/scans", plan_id=slow)["id"], [], []
        watcher = threading.Thread(target=lambda: watched.append(Client(cluster, seed + 1).watch(scan)))
        watcher.start()
        begun = time.monotonic()
        with Killer(cluster, postgres, seaweed, seed) as killer:
            for number in range(JOBS):
                asked = {"scan_id": first["id"], "parameters": {"modes": 16}}
                seen.append(client.make("/reconstructions", **asked)["id"])
                time.sleep(max(0.0, begun + SECONDS * (number + 1) / JOBS - time.monotonic()))
            killer._thread.join()
        jobs = [until(lambda each=each: ended(client, each), PATIENCE, tell=cluster.said) for each in seen]
        watcher.join()
        done, stored = watched[0]
        told = Counter(job["state"] for job in jobs)
        starts = Counter(job["attempt"] for job in jobs)
        again = sum(change["state"] == "interrupted" for change in done["history"])
        with capsys.disabled():
            print(f"\n  seed {seed}; killed {dict(killer.killed)}; failures answered {dict(client.unanswered)}")
            print(f"  {len(set(seen))} jobs: {dict(told)}, by their starts {dict(sorted(starts.items()))}")
            print(f"  scan {done['state']}: {done['summary']}, interrupted {again} times")
            print(f"  the scanner fired {laser.send_command('report')['shots']} shots")
        assert len(set(seen)) == JOBS
        assert set(told) <= {"succeeded", "failed"}
        assert all(job["state"] == "succeeded" or job["attempt"] >= 3 for job in jobs), "only the third death is final"
        assert done["state"] == "complete", done
        assert done["summary"]["stored"] == done["summary"]["points"]
        assert stored == sorted(stored), "no A-line that was stored is lost"
        kept(cluster, seen, jobs, scan, capsys)


def grid(client, per_axis):
    mask = {"arrangement": "grid", "aperture": 13.56e-3, "interval": 13.56e-3 / per_axis, "count": per_axis}
    return client.make("/masks", **mask)["id"]


def ended(client, job_id):
    job = client.get(f"/reconstructions/{job_id}")
    return job if job["state"] in OVER else None


def is_kept_whole(store, database, scan):
    """Tell whether the store has the scan's last version, not only what an interruption had kept."""
    with database.read() as session:
        row = session.scalar(select(ScanRow).where(ScanRow.id == scan))
    found = store.find_row(f"scans/{scan}.h5")
    return found is not None and not is_stale(row, found)


def kept(cluster, seen, jobs, scan, capsys):
    """Compare what is in the store with what it should be."""
    settings = Settings.create(data=cluster.first.folder, **cluster.shared)
    database = Database(metadata_url(settings))
    try:
        store = S3BlobStore(settings, database)
        until(lambda: is_kept_whole(store, database, scan))
        before = store.audit(timedelta(0))
        swept = store.collect_orphans(timedelta(0))
        after, rows = store.audit(timedelta(0)), store.rows()
        with capsys.disabled():
            print(f"  {before.objects} objects, {before.bytes / 1e6:.1f} MB; {swept} orphans swept")
        assert (after.missing, after.orphans) == ([], [])
        assert all(store.is_whole(row.name) for row in rows), "no object is half-written"
        names = Counter(row.name for row in rows)
        for job_id, job in zip(seen, jobs, strict=True):
            assert names[f"jobs/{job_id}/volume.h5"] == (job["state"] == "succeeded")
        hashes = {row.sha256 for row in rows if row.name.endswith("volume.h5")}
        with capsys.disabled():
            print(f"  {sum(row.name.endswith('volume.h5') for row in rows)} volumes of {len(hashes)} contents")
    finally:
        database.close()
