"""The object store: nothing half-written is seen, nothing foreign is taken, orphans go, copies are bounded."""

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from datetime import timedelta
from threading import Event

import httpx
import numpy as np
import obstore
import pytest
from obstore.store import S3Store
from sqlalchemy import delete

from steradian.errors import DamagedFile, InvalidInput, NotFound, StoreUnavailable, Superseded
from steradian.jobs.keeping import JobKeeper, put_results
from steradian.jobs.ledger import JobLedger
from steradian.jobs.model import JobRequest, Succeeded
from steradian.runtime.acquisition import Acquisition, ScannerPort
from steradian.runtime.keeping import ScanKeeper
from steradian.runtime.moving import move_to_store
from steradian.scans.settling import count_alines
from steradian.scans.store import AlineStore, create_scan_file
from steradian.settings import Settings
from steradian.storage import belonging
from steradian.storage.arrays import result_name, scan_name, upload_name
from steradian.storage.cache import Cache
from steradian.storage.database import Database
from steradian.storage.masks import MaskRepository
from steradian.storage.object_store import ObjectStore
from steradian.storage.paths import DataDirectory
from steradian.storage.plans import PlanRepository
from steradian.storage.scans import ScanRepository
from steradian.storage.states import DesiredScanState, ScanState
from steradian.storage.tables import ScanRow
from support.alines import Aline
from support.seaweed import SECRET
from support.stores import psycopg_url, settings_of

pytestmark = pytest.mark.long
MIB, NOW = 1 << 20, timedelta(0)
SENDER = """
import os, signal, sys, threading
from pathlib import Path
from steradian.storage import bucket

class Killing:
    '''A file that ends the process once some parts of it were read.'''
    def __init__(self, path, parts):
        self.file, self.left = open(path, "rb"), parts * bucket.PART
    def read(self, count=-1):
        if self.left < 0:
            os.kill(os.getpid(), signal.SIGKILL)
        piece = self.file.read(count)
        self.left -= len(piece)
        return piece
    def __getattr__(self, name):
        return getattr(self.file, name)

place = bucket.Bucket(os.environ["STERADIAN_STORE"], sys.argv[2])
place._library.put(place._store, "scans/s1.h5/0123", Killing(sys.argv[1], int(sys.argv[3])), chunk_size=bucket.PART)
"""


@pytest.fixture
def store(make_store, tmp_path):
    return make_store(tmp_path / "here")


@pytest.fixture
def objects(store, seaweed):
    """The bucket as it is, without names."""
    return S3Store.from_url(store.place, config={"endpoint": seaweed.endpoint}, client_options={"allow_http": True})


def keys(objects):
    return sorted(each["path"] for page in obstore.list(objects) for each in page if each["path"] != "identity")


def file_of(folder, content):
    path = folder / "file.h5"
    path.write_bytes(content)
    return path


def test_an_object_without_a_row_is_nothing_until_it_is_swept(store, objects, tmp_path):
    store.put(scan_name("s1"), file_of(tmp_path, b"A-lines"))
    assert len(keys(objects)) == 1
    assert store.stat(scan_name("s1")) is None
    with pytest.raises(NotFound):
        store.open(scan_name("s1"))
    assert store.sweep() == 0, "it may wait for its row"
    assert store.sweep(NOW) == 1
    assert keys(objects) == []


def test_what_was_swept_before_its_row_came_is_not_announced(store, tmp_path, rows):
    stored = store.put(scan_name("s1"), file_of(tmp_path, b"A-lines"))
    store.sweep(NOW)
    with pytest.raises(StoreUnavailable), rows.write() as session:
        store.announce(session, stored)
    assert store.stat(scan_name("s1")) is None


def test_a_name_that_is_kept_anew_leaves_the_earlier_object_to_be_swept(store, objects, tmp_path):
    for content in (b"interrupted", b"whole"):
        store.keep(scan_name("s1"), file_of(tmp_path, content))
    assert store.open(scan_name("s1")).read_bytes() == b"whole"
    assert len(keys(objects)) == 2
    assert store.sweep(NOW) == 1
    assert store.contents(NOW).orphans == []
    assert store.is_whole(scan_name("s1"))


def test_another_host_gets_the_same_bytes_and_the_same_time(store, make_store, tmp_path):
    content = os.urandom(20 * MIB)
    store.keep(result_name("j1", "volume.h5"), file_of(tmp_path, content))
    other = make_store(tmp_path / "there", store)
    here, there = (each.open(result_name("j1", "volume.h5")) for each in (store, other))
    assert here.read_bytes() == there.read_bytes() == content
    assert here.stat().st_mtime_ns == there.stat().st_mtime_ns, "ETags are made of it"
    assert there.is_relative_to(tmp_path / "there")


def test_bytes_that_changed_in_the_store_are_refused_and_not_kept(store, objects, make_store, tmp_path):
    store.keep(scan_name("s1"), file_of(tmp_path, b"A-lines"))
    (key,) = keys(objects)
    objects.put(key, b"A-lineS")
    other = make_store(tmp_path / "there", store)
    with pytest.raises(DamagedFile, match="checksum"):
        other.open(scan_name("s1"))
    assert not [path for path in (tmp_path / "there" / "cache").glob("*") if path.is_file()]
    assert not store.is_whole(scan_name("s1"))
    assert store.contents().missing == []
    objects.delete(key)
    assert store.contents().missing == [scan_name("s1")]
    with pytest.raises(DamagedFile, match="any more"):
        other.open(scan_name("s1"))


def test_copies_stay_within_their_bound_and_those_in_use_stay(store, make_store, tmp_path):
    names = [upload_name(f"u{number}") for number in range(30)]
    for name in names:
        store.keep(name, file_of(tmp_path, os.urandom(MIB // 4)))
    other = make_store(tmp_path / "there", store, store_cache_bytes=MIB)
    held = [other.open(name) for name in names[:16]]
    assert all(path.exists() for path in held), "this process has just asked for them"
    for name in names:
        other.open(name)
    for name in reversed(names):
        assert len(other.open(name).read_bytes()) == MIB // 4
    left = [path.stat().st_size for path in (tmp_path / "there" / "cache").glob("*") if path.is_file()]
    assert len(left) <= 17, "those that are held, and the last"


def test_many_who_ask_at_once_get_one_copy(store, make_store, tmp_path):
    store.keep(scan_name("s1"), file_of(tmp_path, os.urandom(4 * MIB)))
    other, found = make_store(tmp_path / "there", store), []
    threads = [threading.Thread(target=lambda: found.append(other.open(scan_name("s1")))) for _ in range(12)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 12
    assert len({path.stat().st_ino for path in found}) == 1


def test_a_large_copy_under_way_holds_up_no_other(tmp_path):
    """Two of one first digit: a picture is had while a volume is fetched."""
    cache, copies = Cache(tmp_path, MIB), []

    def fetch(draft):
        copies.append(cache.get("a2f.png", 1, 0.0, lambda picture: picture.write_bytes(b"p")))
        draft.write_bytes(b"v")

    copies.append(cache.get("a1f.h5", 1, 0.0, fetch))
    assert [copy.read_bytes() for copy in copies] == [b"p", b"v"]


def test_a_signed_address_is_readable_by_anybody_in_ranges(store, tmp_path):
    store.keep(scan_name("s1"), file_of(tmp_path, b"0123456789"))
    answer = httpx.get(store.url(scan_name("s1"), 60), headers={"Range": "bytes=2-5"}, timeout=90)
    assert (answer.status_code, answer.content) == (206, b"2345")


def test_a_scan_that_was_resumed_is_read_from_its_file_again(store, tmp_path):
    path = tmp_path / "here" / "scans" / "s1.h5"
    path.write_bytes(b"half")
    store.keep(scan_name("s1"), file_of(tmp_path, b"half"))
    os.utime(path, (1, 1))
    assert store.open(scan_name("s1")) != path
    path.write_bytes(b"more")
    os.utime(path, (2**32, 2**32))
    assert store.open(scan_name("s1")) == path


def test_a_worker_that_was_cut_off_makes_nothing_known(store, rows, seaweed, tmp_path):
    ledger, outcomes = JobLedger(rows), []
    with rows.write() as session:
        ledger.add(session, JobRequest("j1", "sound-speed", {}))
    fences = [ledger.start("j1", worker).fence for worker in ("cut off", "other")]
    for fence in fences:
        folder = DataDirectory(tmp_path / f"host {fence}").job("j1")
        keeper = JobKeeper(settings_of(tmp_path / f"host {fence}", seaweed, store.place), rows)
        folder.root.mkdir()
        (folder.root / "curve.json").write_text(f"of start {fence}")
        outcomes.append(keeper.announced(Succeeded({"speed": 1500} | put_results(store, folder))))
    with pytest.raises(Superseded):
        ledger.settle("j1", fences[0], outcomes[0], "cut off")
    assert store.stat("jobs/j1/curve.json") is None
    assert ledger.settle("j1", fences[1], outcomes[1], "other").result == {"speed": 1500}
    assert store.open("jobs/j1/curve.json").read_text() == f"of start {fences[1]}"
    assert store.sweep(NOW) == 1


def test_what_is_left_of_a_job_that_no_start_of_the_database_made_is_left_alone(store, rows, seaweed, tmp_path):
    """As where the database was restored to an earlier moment: the folder knows a later start than the row."""
    ledger, data = JobLedger(rows), DataDirectory(tmp_path / "here")
    folders = []
    for job, start in (("j1", 7), ("j2", 1)):
        with rows.write() as session:
            ledger.add(session, JobRequest(job, "sound-speed", {}))
        fence = ledger.start(job, "w").fence
        ledger.settle(job, fence, Succeeded({"speed": 1500}), "w")
        folder = data.job(job)
        folder.begin(start)
        folder.log.write_text("what it said")
        folders.append(folder)
    JobKeeper(settings_of(tmp_path / "here", seaweed, store.place), rows).tidy(ledger, data)
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
            fence, folder = ledger.start(job, host).fence, data.job(job)
            folder.begin(fence)
            folder.log.write_text("what it said")
            (folder.root / "curve.json").write_text(f"of {host}")
    keeper = JobKeeper(settings_of(tmp_path / "cut off", seaweed, store.place), rows)
    ledger.settle("j1", fence, keeper.announced(Succeeded(put_results(store, there.job("j1")))), "other")
    ledger.settle("j2", fence, Succeeded({"speed": 1500}), "other")  # of before there was a store
    keeper.tidy(ledger, here)
    assert [here.job(job).root.exists() for job in ("j1", "j2")] == [False, True]
    assert store.open("jobs/j1/curve.json").read_text() == "of other"


def test_a_log_that_a_host_puts_away_late_replaces_no_later_start_s(store, rows, seaweed, tmp_path):
    """As where a host was cut off in start 1, another one did start 2, and the first one is back."""
    ledger = JobLedger(rows)
    with rows.write() as session:
        ledger.add(session, JobRequest("j1", "sound-speed", {}))
    for host in ("cut off", "other"):
        start, data = ledger.start("j1", host).fence, DataDirectory(tmp_path / host)
        data.job("j1").begin(start)
        data.job("j1").log.write_text(f"of {host}")
    ledger.settle("j1", start, Succeeded({"speed": 1500}), "other")
    for host in ("other", "cut off"):
        JobKeeper(settings_of(tmp_path / host, seaweed, store.place), rows).tidy(ledger, DataDirectory(tmp_path / host))
    told = {name: store.open(name).read_text() for name in store.names("jobs/j1/")}
    assert told == {"jobs/j1/log-0001.txt": "of cut off", "jobs/j1/log-0002.txt": "of other"}


def test_the_log_of_a_job_that_was_deleted_meanwhile_is_not_kept(store, rows, seaweed, tmp_path):
    folder = DataDirectory(tmp_path / "here").job("j1")
    folder.begin(1)
    folder.log.write_text("what it said")
    JobKeeper(settings_of(tmp_path / "here", seaweed, store.place), rows).put_away("j1", 1, folder)
    assert list(store.names("jobs/j1/")) == []
    assert store.sweep(NOW) == 1


def test_a_service_does_not_start_without_the_store_that_has_its_scans(store, rows, seaweed, tmp_path):
    with_store = settings_of(tmp_path / "here", seaweed, store.place)
    belonging.bind(with_store, rows)
    assert belonging.check(with_store, rows)
    for use in (belonging.bind, belonging.check):
        with pytest.raises(InvalidInput, match="STERADIAN_STORE is missing"):
            use(with_store.model_copy(update={"store": None}), rows)
    store.leave()
    belonging.bind(with_store.model_copy(update={"store": None}), rows)


def test_a_scan_is_kept_when_it_is_over_and_its_file_goes_later(store, rows, plan, make_store, tmp_path, monkeypatch):
    MaskRepository(rows).put(plan.mask)
    scans, data = ScanRepository(rows), DataDirectory(tmp_path / "here")
    scan = scans.queue(PlanRepository(rows).put(plan)[0], simulated=True).id
    data.scan_file(scan).write_bytes(b"half of it")
    keeper, other = ScanKeeper(store, scans, data), make_store(tmp_path / "there", store)
    for state in (ScanState.ARMING, ScanState.RUNNING):
        scans.transition(scan, state, why="test")
        keeper.step()
        assert store.kept(scan_name(scan)) is None, "it is written to"
    scans.transition(scan, ScanState.INTERRUPTED, why="test")
    keeper.step()
    assert other.open(scan_name(scan)).read_bytes() == b"half of it"
    data.scan_file(scan).write_bytes(b"all of it")  # by who resumed it
    os.utime(data.scan_file(scan), (2**31, time.time() + 60))
    assert store.open(scan_name(scan)).read_bytes() == b"all of it"
    assert other.open(scan_name(scan)).read_bytes() == b"half of it", "a copy that is resumed is not written to"
    scans.transition(scan, ScanState.PARTIAL, why="test")
    keeper.step()
    assert other.open(scan_name(scan)).read_bytes() == b"all of it"
    keeper.step()
    assert data.scan_file(scan).exists(), "somebody may be reading it"
    monkeypatch.setattr("steradian.runtime.keeping.LEFT_FOR", -1)
    keeper.step()
    assert not data.scan_file(scan).exists()
    assert store.open(scan_name(scan)).read_bytes() == b"all of it"


def test_a_copy_of_before_a_scan_was_resumed_does_not_count_any_more(store, rows, plan, make_store, tmp_path):
    MaskRepository(rows).put(plan.mask)
    scans, data = ScanRepository(rows), DataDirectory(tmp_path / "here")
    scan, other = (
        scans.queue(PlanRepository(rows).put(plan)[0], simulated=True).id,
        make_store(tmp_path / "there", store),
    )
    data.scan_file(scan).write_bytes(b"half of it")
    keeper, name = ScanKeeper(store, scans, data), scan_name(scan)
    for state in (ScanState.ARMING, ScanState.RUNNING, ScanState.INTERRUPTED):
        scans.transition(scan, state, why="test")
    keeper.step()
    assert other.open(name).read_bytes() == b"half of it"
    for state in (ScanState.ARMING, ScanState.RUNNING, ScanState.INTERRUPTED):
        scans.transition(scan, state, why="test")
        assert other.stat(name) is None
        with pytest.raises(NotFound):
            other.open(name)
    data.scan_file(scan).write_bytes(b"more of it")
    keeper.step()
    assert other.open(name).read_bytes() == b"more of it"
    scans.transition(scan, ScanState.PARTIAL, why="test")
    assert other.open(name).read_bytes() == b"more of it", "to be content with it changes nothing"


@pytest.mark.parametrize("reached", [[], [ScanState.RUNNING]], ids=["armed", "running"])
def test_a_scan_that_was_resumed_in_vain_can_still_be_had_when_its_file_has_gone(
    store, rows, plan, make_store, tmp_path, monkeypatch, reached
):
    """Its link was down for example, so not an A-line came: what is kept is all that there is."""
    MaskRepository(rows).put(plan.mask)
    scans, data = ScanRepository(rows), DataDirectory(tmp_path / "here")
    scan, other = (
        scans.queue(PlanRepository(rows).put(plan)[0], simulated=True).id,
        make_store(tmp_path / "there", store),
    )
    data.scan_file(scan).write_bytes(b"half of it")
    keeper, name = ScanKeeper(store, scans, data), scan_name(scan)
    for state in (ScanState.ARMING, ScanState.RUNNING, ScanState.INTERRUPTED):
        scans.transition(scan, state, why="test")
    keeper.step()
    for state in (ScanState.ARMING, *reached, ScanState.INTERRUPTED):
        scans.transition(scan, state, why="test")
    keeper.step()
    assert other.open(name).read_bytes() == b"half of it"
    scans.transition(scan, ScanState.PARTIAL, why="test")
    monkeypatch.setattr("steradian.runtime.keeping.LEFT_FOR", -1)
    keeper.step()
    assert not data.scan_file(scan).exists()
    assert store.open(name).read_bytes() == other.open(name).read_bytes() == b"half of it"


def test_of_a_scan_that_went_on_and_was_lost_with_its_node_counts_what_the_store_has(
    store, rows, plan, make_store, tmp_path
):
    MaskRepository(rows).put(plan.mask)
    scans, data = ScanRepository(rows), DataDirectory(tmp_path / "here")
    scan, other = scans.queue(PlanRepository(rows).put(plan)[0], simulated=True).id, make_store(tmp_path / "new", store)
    create_scan_file(data.scan_file(scan), plan, scan_id=scan)
    write(data.scan_file(scan), plan, range(5))
    keeper, name = ScanKeeper(store, scans, data), scan_name(scan)
    for state in (ScanState.ARMING, ScanState.RUNNING, ScanState.INTERRUPTED):
        scans.transition(scan, state, why="test")
    keeper.step()
    for state in (ScanState.ARMING, ScanState.RUNNING, ScanState.INTERRUPTED):  # it went on, and its node was lost
        scans.transition(scan, state, why="test")
    write(data.scan_file(scan), plan, range(5, 9))
    with pytest.raises(NotFound):
        other.open(name)
    lost = DataDirectory(tmp_path / "new")
    new = Acquisition(
        scans, PlanRepository(rows), lost, ScannerPort(Settings.create(data=lost.root)), Event(), arrays=other
    )
    scans.desire(scan, DesiredScanState.STOPPED, "the node burnt down")
    new.step()
    row = scans.get(scan)
    assert (row.state, row.summary["stored"]) == (ScanState.PARTIAL, 5)
    assert count_alines(other.open(name)) == row.summary, "who asks for it gets what is told of it"
    keeper.step()  # the lost folder turns up: what it has is newer
    assert count_alines(other.open(name))["stored"] == 9


@pytest.fixture
def interrupted(rows, plan, tmp_path):
    """A scan that may be resumed, with its repository and folder, and a file."""
    MaskRepository(rows).put(plan.mask)
    scans, data = ScanRepository(rows), DataDirectory(tmp_path / "here")

    def make():
        scan = scans.queue(PlanRepository(rows).put(plan)[0], simulated=True).id
        for state in (ScanState.ARMING, ScanState.RUNNING, ScanState.INTERRUPTED):
            scans.transition(scan, state, why="test")
        data.scan_file(scan).write_bytes(b"half of it")
        return scan

    return scans, data, make


def resume(scans, scan, data):
    for state in (ScanState.ARMING, ScanState.RUNNING, ScanState.COMPLETING):
        scans.transition(scan, state, why="test")
    data.scan_file(scan).write_bytes(b"all of it!")
    scans.transition(scan, ScanState.COMPLETE, why="test")


@pytest.mark.parametrize("when", ["while it is copied", "while it is sent"])
def test_a_scan_that_is_deleted_while_it_is_kept_is_not_known_and_the_next_one_is_kept(
    store, rows, objects, interrupted, when, monkeypatch
):
    scans, data, make = interrupted
    gone, other = sorted([make(), make()])

    def delete_it():
        with rows.write() as session:
            session.execute(delete(ScanRow).where(ScanRow.id == gone))

    copy, put = shutil.copy2, store.put

    def copied(source, target):
        copy(source, target)
        if when == "while it is copied" and source == data.scan_file(gone):
            delete_it()

    def sent(name, *about):
        stored = put(name, *about)
        if when == "while it is sent" and name == scan_name(gone):
            delete_it()
        return stored

    monkeypatch.setattr("steradian.runtime.keeping.shutil.copy2", copied)
    monkeypatch.setattr(store, "put", sent)
    keeper = ScanKeeper(store, scans, data)
    keeper.step()
    assert (store.kept(scan_name(gone)), store.kept(scan_name(other)) is None) == (None, False)
    keeper.step()
    assert not data.scan_file(gone).exists()
    store.sweep(NOW)
    assert [key.rpartition("/")[0] for key in keys(objects)] == [scan_name(other)]


def test_what_is_stored_while_an_earlier_state_is_sent_is_kept_too(
    store, interrupted, make_store, tmp_path, monkeypatch
):
    """It was interrupted, and a person resumed it at once: the few A-lines that it lacked took no time."""
    scans, data, make = interrupted
    scan, put = make(), store.put

    def sent(name, *about):
        if scans.get(scan).state is ScanState.INTERRUPTED:
            resume(scans, scan, data)
        return put(name, *about)

    monkeypatch.setattr(store, "put", sent)
    monkeypatch.setattr("steradian.runtime.keeping.LEFT_FOR", -1)
    keeper = ScanKeeper(store, scans, data)
    for _ in range(4):
        keeper.step()
    assert not data.scan_file(scan).exists()
    assert make_store(tmp_path / "there", store).open(scan_name(scan)).read_bytes() == b"all of it!"


def test_a_scan_that_was_resumed_since_it_was_kept_moves_to_the_store_as_it_is(
    store, rows, interrupted, make_store, tmp_path
):
    """The store was away when it was over. A scan's file has its full size from the start."""
    scans, data, make = interrupted
    scan = make()
    ScanKeeper(store, scans, data).step()
    resume(scans, scan, data)
    assert move_to_store(store, rows, data, lambda *_: None) == 1
    assert not data.scan_file(scan).exists()
    assert make_store(tmp_path / "there", store).open(scan_name(scan)).read_bytes() == b"all of it!"


def test_a_keeper_goes_on_whatever_is_raised_and_clears_what_a_killed_one_left(store, interrupted, monkeypatch, caplog):
    scans, data, make = interrupted
    scan, over, looks = make(), Event(), []
    left = data.cache / "keeping" / "1-1"
    left.parent.mkdir(parents=True)
    left.write_bytes(b"half of a copy")
    keeper = ScanKeeper(store, scans, data)
    step = keeper.step

    def look():
        looks.append(left.exists())
        if len(looks) == 1:
            raise NotFound("scan", scan)
        step()
        over.set()

    monkeypatch.setattr(keeper, "step", look)
    monkeypatch.setattr("steradian.runtime.keeping.LOOK_EVERY", 0.01)
    keeper.run(over)
    assert (looks, store.kept(scan_name(scan)) is None) == ([False, False], False)


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
    put_results(store, folder)
    assert there[0] == ("volume.h5", True)


def write(path, plan, points):
    with AlineStore(path) as opened:
        opened.append(Aline(point, np.full(plan.samples, point + 1, np.int16), point + 1, 0.5) for point in points)
        opened.set_fired(max(points) + 1)


def test_the_file_of_a_scan_that_another_node_deletes_goes_and_one_that_nobody_can_have_deleted_stays(
    store, rows, plan, tmp_path
):
    """What is under way cannot be deleted: a standby that took over without the last rows knows nothing of it."""
    MaskRepository(rows).put(plan.mask)
    scans, data = ScanRepository(rows), DataDirectory(tmp_path / "here")
    held, fired = (scans.queue(PlanRepository(rows).put(plan)[0], simulated=True).id for _ in range(2))
    for state in (ScanState.ARMING, ScanState.RUNNING, ScanState.INTERRUPTED):
        scans.transition(held, state, why="test")
    for state in (ScanState.ARMING, ScanState.RUNNING):
        scans.transition(fired, state, why="test")
    for name in (held, fired, "s0unknown"):
        data.scan_file(name).write_bytes(b"A-lines")
    keeper = ScanKeeper(store, scans, data)
    keeper.step()
    with rows.write() as session:
        session.execute(delete(ScanRow).where(ScanRow.id.in_([held, fired])))
    keeper.step()
    assert {path.stem for path in data.scan_files()} == {fired, "s0unknown"}


def test_who_is_killed_while_sending_leaves_nothing_that_is_seen(store, objects, seaweed, tmp_path):
    path = file_of(tmp_path, os.urandom(96 * MIB))
    settings = dict(os.environ, STERADIAN_STORE=store.place, STERADIAN_DATA=str(tmp_path / "killed"))
    for part in (1, 2, 4):
        sender = subprocess.Popen([sys.executable, "-c", SENDER, str(path), seaweed.endpoint, str(part)], env=settings)
        assert sender.wait(250) == -signal.SIGKILL
        assert keys(objects) == []
        assert store.stat(scan_name("s1")) is None
    store.keep(scan_name("s1"), path)
    assert store.is_whole(scan_name("s1"))
    assert len(keys(objects)) == 1


def test_store_and_database_must_belong_together(store, seaweed, rows, postgres, tmp_path):
    assert store.check()
    other = Database(psycopg_url(postgres.database()))
    other.migrate()
    about = {"data": tmp_path, "store_endpoint": seaweed.endpoint, "database_url": "postgresql://unused"}
    ours, foreign = ObjectStore(Settings.create(store=store.place, **about), other), seaweed.bucket()
    assert not ours.check(), "no service has bound that database"
    store.keep(scan_name("s1"), file_of(tmp_path, b"1"))
    with pytest.raises(InvalidInput, match="the store of this database"):
        ours.bind()
    elsewhere = ObjectStore(Settings.create(store=foreign, **about), rows)
    for use in (elsewhere.check, elsewhere.bind):
        with pytest.raises(InvalidInput, match="the store of this database"):
            use()
    assert not elsewhere.answers()
    other.close()


def test_a_store_that_is_gone_is_said_to_be_so_without_its_key(rows, tmp_path, caplog):
    settings = Settings.create(
        data=tmp_path, store="s3://gone", store_endpoint="http://127.0.0.1:9", database_url="postgresql://unused"
    )
    store = ObjectStore(settings, rows, patience=timedelta(seconds=0.1))
    with pytest.raises(StoreUnavailable) as said:
        store.put(scan_name("s1"), file_of(tmp_path, b"1"))
    assert "s3://gone" in str(said.value)
    assert SECRET not in f"{said.value} {settings!r} {caplog.text} {settings.model_dump_json()}"
