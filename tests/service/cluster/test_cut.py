"""A worker whose network is gone and comes back: what another one did meanwhile stands."""

import hashlib
from contextlib import contextmanager
from datetime import timedelta

import pytest

from steradian.core.settings import Settings
from steradian.storage.blobs.object_store import S3BlobStore
from steradian.storage.db.database import Database, metadata_url
from support.cluster import Cluster, Worker
from support.proxy import Proxy
from support.waiting import until

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]
LONG = {"regularisation": "none", "change": 0.0, "discrepancy": None, "iterations": 3000, "highest_frequency": 5e6}
PARAMETERS = {"modes": 24, "method": "iterative", "iterative": LONG}
"""A job that is still at work when its worker's network goes, on a quick machine too."""


@pytest.fixture
def proxies(postgres, seaweed):
    """A network between a worker and the others, of which it knows nothing else: makes its part of the settings."""
    made = []

    def between(shared):
        made.extend((Proxy(shared["database_url"]), Proxy(shared["store_endpoint"])))
        return shared | {"database_url": made[0].url, "store_endpoint": made[1].url}

    between.made = made
    yield between
    for proxy in made:
        proxy.close()


def test_partitioned_worker_changes_nothing_after_reconnecting(tmp_path, postgres, seaweed, proxies):
    scanners = {"scanner-0": "simulated"}
    with Cluster(tmp_path, postgres, seaweed, scanners, simulator_speed=20.0) as cluster:
        node = cluster.first
        far = Worker(tmp_path / "far", "far", **proxies(cluster.shared))
        near = Worker(tmp_path / "near", "near", **cluster.shared)
        scan = node.make("/scans", plan_id=node.plan())
        try:
            far.start()
            asked = {"scan_id": scan["id"], "parameters": PARAMETERS}
            job = node.http.post("/reconstructions", json=asked).raise_for_status().json()
            until(lambda: at_work(node, job) == ["far-0"], tell=far.log.read_text)
            for proxy in proxies.made:
                proxy.hang()
            near.start()
            until(lambda: at_work(node, job) == ["far-0", "near-0"], tell=near.log.read_text)
            until(lambda: node.get(f"/jobs/{job['id']}").json()["state"] == "succeeded")
            until(lambda: all_kept(cluster))
            stood = standing(cluster, node, job)
            for proxy in proxies.made:
                proxy.mend()
            until(lambda: "another worker has it" in far.log.read_text(), tell=far.log.read_text)
            near.close()
            again = node.done("/reconstructions", scan_id=scan["id"], parameters={"modes": 24})
            assert at_work(node, again) == ["far-0"], "it works again"
            view, volume, kept = standing(cluster, node, job)
            kept.pop(f"jobs/{job['id']}/log-0001.txt", None)  # what its own start had to say
            assert (view, volume, kept) == stood
            assert [start["outcome"] for start in attempts(node, job)] == ["died", "succeeded"]
        finally:
            far.close()
            near.close()


def attempts(node, job):
    return node.get(f"/jobs/{job['id']}/attempts").json()["items"]


def at_work(node, job):
    """Who has started a job, in that order, once the last one has got so far as to iterate."""
    stage = node.get(f"/jobs/{job['id']}").json()["progress"]["stage"]
    starts = attempts(node, job)
    return [start["worker"] for start in starts] if stage not in {None, "starting"} else []


def all_kept(cluster):
    """Whether all that succeeded is in the store."""
    with store_of(cluster) as store:
        return not store.audit(timedelta(0)).missing


def standing(cluster, node, job):
    """All that anybody can see of a job: its view, the bytes of its volume and what the store keeps of it, swept."""
    volume = node.get(f"/reconstructions/{job['id']}/volume", headers={"Accept": "application/octet-stream"})
    with store_of(cluster) as store:
        store.collect_orphans(timedelta(0))
        contents = store.audit(timedelta(0))
        assert (contents.missing, contents.orphans) == ([], [])
        rows = {row.name: row.sha256 for row in store.rows() if job["id"] in row.name}
        assert rows
        assert all(store.is_whole(name) for name in rows)
    view = node.get(f"/jobs/{job['id']}").json()
    return view, hashlib.sha256(volume.content).hexdigest(), rows


@contextmanager
def store_of(cluster):
    """The store of a cluster, as its first node sees it."""
    settings = Settings.create(data=cluster.first.folder, **cluster.shared)
    database = Database(metadata_url(settings))
    try:
        yield S3BlobStore(settings, database)
    finally:
        database.close()
