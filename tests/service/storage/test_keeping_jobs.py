"""What a job left goes into the object store, once, and by whoever may."""

from datetime import timedelta

import pytest

from steradian.core.exceptions import StaleFence
from steradian.jobs.job import JobRequest, Succeeded
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.jobs.worker.results import ResultUploader, upload_results
from steradian.storage.data_dir.layout import DataDirectory
from support.stores import settings_of

pytestmark = pytest.mark.long


def test_a_worker_that_was_cut_off_makes_nothing_known(store, rows, seaweed, tmp_path):
    ledger, outcomes = JobLedger(rows), []
    with rows.write() as session:
        ledger.add(session, JobRequest("j1", "sound-speed", {}))
    fences = [ledger.start_attempt("j1", worker).fence for worker in ("cut off", "other")]
    for fence in fences:
        folder = DataDirectory(tmp_path / f"host {fence}").job("j1")
        keeper = ResultUploader(settings_of(tmp_path / f"host {fence}", seaweed, store.place), rows)
        folder.root.mkdir()
        (folder.root / "curve.json").write_text(f"of start {fence}")
        outcomes.append(keeper.with_commit(Succeeded({"speed": 1500} | upload_results(store, folder))))
    with pytest.raises(StaleFence):
        ledger.finish_attempt("j1", fences[0], outcomes[0], "cut off")
    assert store.stat("jobs/j1/curve.json") is None
    assert ledger.finish_attempt("j1", fences[1], outcomes[1], "other").result == {"speed": 1500}
    assert store.open("jobs/j1/curve.json").read_text() == f"of start {fences[1]}"
    assert store.collect_orphans(timedelta(0)) == 1


def test_upload_leftovers_skips_job_folder_with_newer_fence(store, rows, seaweed, tmp_path):
    """As where the database was restored to an earlier moment: the folder knows a later start than the row."""
    ledger, data = JobLedger(rows), DataDirectory(tmp_path / "here")
    folders = []
    for job, start in (("j1", 7), ("j2", 1)):
        with rows.write() as session:
            ledger.add(session, JobRequest(job, "sound-speed", {}))
        fence = ledger.start_attempt(job, "w").fence
        ledger.finish_attempt(job, fence, Succeeded({"speed": 1500}), "w")
        folder = data.job(job)
        folder.begin_attempt(start)
        folder.log.write_text("what it said")
        folders.append(folder)
    ResultUploader(settings_of(tmp_path / "here", seaweed, store.place), rows).upload_leftovers(ledger, data)
    assert [folder.root.exists() for folder in folders] == [True, False]


def test_results_that_the_store_has_of_another_host_stay_nowhere_else(store, rows, seaweed, tmp_path):
    """A start was cut off when its volume was written; another host made it anew."""
    ledger = JobLedger(rows)
    with rows.write() as session:
        ledger.add(session, JobRequest("j1", "sound-speed", {}))
        ledger.add(session, JobRequest("j2", "sound-speed", {}))
    here, there = DataDirectory(tmp_path / "cut off"), DataDirectory(tmp_path / "other")
    for job in ("j1", "j2"):
        for data, host in ((here, "cut off"), (there, "other")):
            fence, folder = ledger.start_attempt(job, host).fence, data.job(job)
            folder.begin_attempt(fence)
            folder.log.write_text("what it said")
            (folder.root / "curve.json").write_text(f"of {host}")
    keeper = ResultUploader(settings_of(tmp_path / "cut off", seaweed, store.place), rows)
    ledger.finish_attempt("j1", fence, keeper.with_commit(Succeeded(upload_results(store, there.job("j1")))), "other")
    ledger.finish_attempt("j2", fence, Succeeded({"speed": 1500}), "other")  # of before there was a store
    keeper.upload_leftovers(ledger, here)
    assert [here.job(job).root.exists() for job in ("j1", "j2")] == [False, True]
    assert store.open("jobs/j1/curve.json").read_text() == "of other"


def test_a_log_that_a_host_puts_away_late_replaces_no_later_start_s(store, rows, seaweed, tmp_path):
    """As where a host was cut off in start 1, another one did start 2, and the first one is back."""
    ledger = JobLedger(rows)
    with rows.write() as session:
        ledger.add(session, JobRequest("j1", "sound-speed", {}))
    for host in ("cut off", "other"):
        start, data = ledger.start_attempt("j1", host).fence, DataDirectory(tmp_path / host)
        data.job("j1").begin_attempt(start)
        data.job("j1").log.write_text(f"of {host}")
    ledger.finish_attempt("j1", start, Succeeded({"speed": 1500}), "other")
    for host in ("other", "cut off"):
        ResultUploader(settings_of(tmp_path / host, seaweed, store.place), rows).upload_leftovers(
            ledger, DataDirectory(tmp_path / host)
        )
    told = {name: store.open(name).read_text() for name in store.list_names("jobs/j1/")}
    assert told == {"jobs/j1/log-0001.txt": "of cut off", "jobs/j1/log-0002.txt": "of other"}


def test_log_upload_of_deleted_job_leaves_no_stored_log(store, rows, seaweed, tmp_path):
    folder = DataDirectory(tmp_path / "here").job("j1")
    folder.begin_attempt(1)
    folder.log.write_text("what it said")
    ResultUploader(settings_of(tmp_path / "here", seaweed, store.place), rows).upload_log_and_remove("j1", 1, folder)
    assert list(store.list_names("jobs/j1/")) == []
    assert store.collect_orphans(timedelta(0)) == 1


def test_pictures_of_a_job_stay_until_its_volume_has_been_sent(store, tmp_path, monkeypatch):
    folder = DataDirectory(tmp_path / "here").job("r1")
    folder.root.mkdir(parents=True)
    for name, size in (("mip-x.png", 10), ("revision.json", 1), ("volume.h5", 1000)):
        (folder.root / name).write_bytes(b"x" * size)
    put, there = store.put, []

    def sent(name, path):
        there.append((path.name, (folder.root / "mip-x.png").exists()))
        return put(name, path)

    monkeypatch.setattr(store, "put", sent)
    upload_results(store, folder)
    assert there[0] == ("volume.h5", True)
