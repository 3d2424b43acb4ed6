"""A backup is of one moment, whatever the service does meanwhile, and keeps what is damaged."""

import pytest

from steradian.jobs.job import JobRequest, Succeeded
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.scans.file.verify import verify_scan_file
from steradian.scans.file.writer import ScanFileWriter
from steradian.storage.blobs.interface import FolderBlobStore
from steradian.storage.db.database import Database, metadata_url
from steradian.storage.repositories.deletion import DeletionService, remove_files
from support.backups import aline, files, once, restored, spoil
from support.damage import BITS
from support.damage import spoil as spoil_header


def test_backup_omits_rows_and_files_of_scan_deleted_during_copy(kept, tmp_path):
    def delete():
        database = kept.database()
        DeletionService(database).delete("scan", kept.scan, "test", dependents=True, check=lambda _kinds: None)
        remove_files(database, kept.data, FolderBlobStore(kept.data), lambda _jobs: None)
        database.close()

    made = kept.back_up(tmp_path / "backup", progress=once(delete))
    assert (made.scans, made.jobs) == (0, 1)
    restored(tmp_path / "backup", tmp_path / "new")
    assert set(files(tmp_path / "new")) == {"uploads/u1"} | {
        f"emergency-stop/{name}" for name in ("pressed", "released", "answered")
    }


def test_an_import_that_ends_meanwhile_is_done_or_has_its_upload(kept, tmp_path):
    def finish():
        database = kept.database()
        ledger = JobLedger(database)
        ledger.finish_attempt(
            "waits", ledger.start_attempt("waits", "worker-0").fence, Succeeded({"scan_id": "s1"}), "worker-0"
        )
        database.close()
        kept.data.upload("u1").unlink()

    kept.back_up(tmp_path / "backup", progress=once(finish))
    settings = restored(tmp_path / "backup", tmp_path / "new")
    database = Database(metadata_url(settings))
    assert JobLedger(database).get("waits").state == "succeeded"
    database.close()


def test_backup_excludes_partial_results_of_running_job(kept, tmp_path):
    database = kept.database()
    ledger = JobLedger(database)
    with database.write() as session:
        ledger.add(session, JobRequest("runs", "reconstruction", {"scan_id": kept.scan}))
    row = ledger.start_attempt("runs", "worker-0")
    folder = kept.data.job("runs")
    folder.begin_attempt(row.fence + 1)  # a later start, which the rows of the backup do not know
    folder.log.write_text("first start\n")
    folder.volume.write_bytes(b"half")
    folder.report.write_text("{}")
    database.close()
    kept.back_up(tmp_path / "backup")
    settings = restored(tmp_path / "backup", tmp_path / "new")
    assert [path.name for path in (settings.data / "jobs" / "runs").iterdir()] == ["log.txt"]


def test_a_scan_is_copied_while_it_is_written_with_all_that_was_stored(kept, tmp_path):
    """An A-line that is measured again is found halfway by the first copy, and whole by the second."""
    scan = kept.running_scan()
    file, draft = kept.data.scan_file(scan), tmp_path / "backup.new" / "scans" / f"{scan}.h5"
    seen = []

    def write(*at):
        if not draft.exists():
            return
        seen.append(at)
        with ScanFileWriter(file) as store:
            if len(seen) == 1:
                spoil(store, 8)
            else:
                store.append([aline(store._order.tolist().index(8))])

    made = kept.back_up(tmp_path / "backup", progress=write)
    assert made.damaged == {}
    assert len(seen) > 2, "it was copied in several pieces, and more than once"
    settings = restored(tmp_path / "backup", tmp_path / "new")
    copied = verify_scan_file(settings.data / "scans" / f"{scan}.h5")
    assert (copied.is_consistent, copied.intact) == (True, 9)


def test_backup_with_damaged_scan_keeps_and_reports_it(kept, tmp_path):
    scan = kept.running_scan()
    with ScanFileWriter(kept.data.scan_file(scan)) as store:
        spoil(store, 8)
    other = kept.running_scan()
    kept.data.scan_file(other).write_bytes(b"no HDF5")
    made = kept.back_up(tmp_path / "backup")
    assert made.damaged.keys() == {scan, other}
    assert made.damaged[scan].startswith("1 A-line")
    restored(tmp_path / "backup", tmp_path / "new")
    assert (tmp_path / "new" / "scans" / f"{other}.h5").read_bytes() == b"no HDF5"


@pytest.mark.parametrize("bit", BITS)
def test_backup_of_scan_with_damaged_header_copies_it_unchanged(kept, tmp_path, bit):
    scan = kept.running_scan()
    file = kept.data.scan_file(scan)
    spoil_header(file, "alines/status", bit)
    made = kept.back_up(tmp_path / "backup")
    assert "is kept as it is" in made.damaged[scan]
    assert (tmp_path / "backup" / "scans" / file.name).read_bytes() == file.read_bytes()
    assert list(made.verify(tmp_path / "backup")) == []
