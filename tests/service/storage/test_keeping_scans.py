"""Scans that are over go into the object store, and whatever happens meanwhile, no A-line is lost."""

import os
import shutil
import time
from datetime import timedelta
from threading import Event

import numpy as np
import pytest
from sqlalchemy import delete

from steradian.core.exceptions import NotFound
from steradian.core.settings import Settings
from steradian.runtime.acquisition import Acquisition, ScannerConnection
from steradian.runtime.archive.scan_uploader import ScanUploader
from steradian.runtime.archive.transfer import move_to_store
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from steradian.scans.summary import count_alines
from steradian.storage.blobs.interface import scan_name
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.tables import ScanRow
from steradian.storage.repositories.masks import MaskRepository
from steradian.storage.repositories.plans import PlanRepository
from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import DesiredScanState, ScanState
from support.alines import Aline
from support.stores import keys

pytestmark = pytest.mark.long


def test_scan_uploader_stores_ended_scan_and_removes_local_file_later(
    store, rows, plan, make_store, tmp_path, monkeypatch
):
    MaskRepository(rows).put(plan.mask)
    scans, data = ScanRepository(rows), DataDirectory(tmp_path / "here")
    scan = scans.queue(PlanRepository(rows).put(plan)[0], simulated=True).id
    data.scan_file(scan).write_bytes(b"half of it")
    keeper, other = ScanUploader(store, scans, data), make_store(tmp_path / "there", store)
    for state in (ScanState.ARMING, ScanState.RUNNING):
        scans.transition(scan, state, why="test")
        keeper.step()
        assert store.find_row(scan_name(scan)) is None, "it is written to"
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
    monkeypatch.setattr("steradian.runtime.archive.scan_uploader.LOCAL_RETENTION", -1)
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
    keeper, name = ScanUploader(store, scans, data), scan_name(scan)
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
def test_scan_resumed_without_new_alines_stays_readable_from_store(
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
    keeper, name = ScanUploader(store, scans, data), scan_name(scan)
    for state in (ScanState.ARMING, ScanState.RUNNING, ScanState.INTERRUPTED):
        scans.transition(scan, state, why="test")
    keeper.step()
    for state in (ScanState.ARMING, *reached, ScanState.INTERRUPTED):
        scans.transition(scan, state, why="test")
    keeper.step()
    assert other.open(name).read_bytes() == b"half of it"
    scans.transition(scan, ScanState.PARTIAL, why="test")
    monkeypatch.setattr("steradian.runtime.archive.scan_uploader.LOCAL_RETENTION", -1)
    keeper.step()
    assert not data.scan_file(scan).exists()
    assert store.open(name).read_bytes() == other.open(name).read_bytes() == b"half of it"


def test_scan_lost_with_its_node_counts_alines_of_stored_copy(store, rows, plan, make_store, tmp_path):
    MaskRepository(rows).put(plan.mask)
    scans, data = ScanRepository(rows), DataDirectory(tmp_path / "here")
    scan, other = scans.queue(PlanRepository(rows).put(plan)[0], simulated=True).id, make_store(tmp_path / "new", store)
    create_scan_file(data.scan_file(scan), plan, scan_id=scan)
    write(data.scan_file(scan), plan, range(5))
    keeper, name = ScanUploader(store, scans, data), scan_name(scan)
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
        scans, PlanRepository(rows), lost, ScannerConnection(Settings.create(data=lost.root)), Event(), arrays=other
    )
    scans.set_desired_state(scan, DesiredScanState.STOPPED, "the node burnt down")
    new.run_once()
    row = scans.get(scan)
    assert (row.state, row.summary["stored"]) == (ScanState.PARTIAL, 5)
    assert count_alines(other.open(name)) == row.summary, "who asks for it gets what is told of it"
    later = scans.clock().timestamp() + 60  # beyond the skew of clocks that is allowed for, however long this took
    os.utime(data.scan_file(scan), (later, later))
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
def test_scan_deleted_during_upload_is_not_stored_and_next_one_is(store, rows, objects, interrupted, when, monkeypatch):
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

    monkeypatch.setattr("steradian.runtime.archive.scan_uploader.shutil.copy2", copied)
    monkeypatch.setattr(store, "put", sent)
    keeper = ScanUploader(store, scans, data)
    keeper.step()
    assert (store.find_row(scan_name(gone)), store.find_row(scan_name(other)) is None) == (None, False)
    keeper.step()
    assert not data.scan_file(gone).exists()
    store.collect_orphans(timedelta(0))
    assert [key.rpartition("/")[0] for key in keys(objects)] == [scan_name(other)]


def test_scan_resumed_during_upload_is_stored_again(store, interrupted, make_store, tmp_path, monkeypatch):
    """It was interrupted, and a person resumed it at once: the few A-lines that it lacked took no time."""
    scans, data, make = interrupted
    scan, put = make(), store.put

    def sent(name, *about):
        if scans.get(scan).state is ScanState.INTERRUPTED:
            resume(scans, scan, data)
        return put(name, *about)

    monkeypatch.setattr(store, "put", sent)
    monkeypatch.setattr("steradian.runtime.archive.scan_uploader.LOCAL_RETENTION", -1)
    keeper = ScanUploader(store, scans, data)
    for _ in range(4):
        keeper.step()
    assert not data.scan_file(scan).exists()
    assert make_store(tmp_path / "there", store).open(scan_name(scan)).read_bytes() == b"all of it!"


def test_move_to_store_of_resumed_scan_stores_its_current_state(store, rows, interrupted, make_store, tmp_path):
    """The store was away when it was over. A scan's file has its full size from the start."""
    scans, data, make = interrupted
    scan = make()
    ScanUploader(store, scans, data).step()
    resume(scans, scan, data)
    assert move_to_store(store, rows, data, lambda *_: None) == 1
    assert not data.scan_file(scan).exists()
    assert make_store(tmp_path / "there", store).open(scan_name(scan)).read_bytes() == b"all of it!"


def test_scan_uploader_continues_after_error_and_removes_stale_copy(store, interrupted, monkeypatch, caplog):
    scans, data, make = interrupted
    scan, over, looks = make(), Event(), []
    left = data.cache / "keeping" / "1-1"
    left.parent.mkdir(parents=True)
    left.write_bytes(b"half of a copy")
    keeper = ScanUploader(store, scans, data)
    step = keeper.step

    def look():
        looks.append(left.exists())
        if len(looks) == 1:
            raise NotFound("scan", scan)
        step()
        over.set()

    monkeypatch.setattr(keeper, "step", look)
    monkeypatch.setattr("steradian.runtime.archive.scan_uploader.POLL_INTERVAL", 0.01)
    keeper.run(over)
    assert (looks, store.find_row(scan_name(scan)) is None) == ([False, False], False)


def write(path, plan, points):
    with ScanFileWriter(path) as opened:
        opened.append(Aline(point, np.full(plan.samples, point + 1, np.int16), point + 1, 0.5) for point in points)
        opened.record_shot_count(max(points) + 1)


def test_uploader_removes_files_of_deleted_scans_but_keeps_running_ones(store, rows, plan, tmp_path):
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
    keeper = ScanUploader(store, scans, data)
    keeper.step()
    with rows.write() as session:
        session.execute(delete(ScanRow).where(ScanRow.id.in_([held, fired])))
    keeper.step()
    assert {path.stem for path in data.scan_files()} == {fired, "s0unknown"}
