"""A scanner as the API shows it: what the scanner says has an age, and is unknown when that is too large."""

import time
from datetime import UTC, datetime, timedelta

import pytest

from steradian.api.schemas.scanners import ScannerView
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.data_dir.scanner_status import CURRENT_ELSEWHERE, ScannerStatus
from steradian.storage.db.database import Database
from steradian.storage.repositories.scanner_lease_and_stop import ScannerRepository

FAULT = {"code": 1, "name": "interlock-opened", "title": "it opened", "remedy": "close it", "clearable": False}


@pytest.fixture
def scanner(tmp_path):
    data = DataDirectory(tmp_path)
    data.create()
    database = Database(data.metadata_url)
    database.migrate()
    repository = ScannerRepository(database)
    repository.ensure(simulated=False)
    yield repository
    database.close()


def view(scanner, later=0.0, status=None):
    row = scanner.get(scanner.id)
    return ScannerView.of(row, status, datetime.now(UTC) + timedelta(seconds=later), held=False, stop=None)


def heard(**told):
    about = {"connection": "connected", "state": "ready", "laser": "off", "shutter": "closed", "interlock": "closed"}
    return ScannerStatus(**about | {"key": "on", "heard": time.monotonic()} | told)


def test_scanner_of_another_node_that_was_never_heard_is_unknown(scanner):
    shown = view(scanner)
    assert (shown.connection, shown.laser, shown.shutter, shown.key) == ("unknown",) * 4
    assert (shown.age, shown.looked_at, shown.look_interval) == (None, None, 4.0)


def test_remote_scanner_status_expires_to_unknown(scanner):
    scanner.note_status(heard(model="FP", serial="7"))
    shown = view(scanner, later=CURRENT_ELSEWHERE - 2)
    assert (shown.connection, shown.laser, shown.serial) == ("connected", "off", "7")
    late = view(scanner, later=CURRENT_ELSEWHERE + 1)
    assert (late.connection, late.laser, late.shutter, late.fault) == ("unknown", "unknown", "unknown", None)
    assert late.age > CURRENT_ELSEWHERE


def test_unchanged_scanner_status_keeps_revision_and_refreshes_timestamp(scanner):
    scanner.note_status(heard())
    before = scanner.get(scanner.id)
    scanner.note_status(heard())
    after = scanner.get(scanner.id)
    assert after.revision == before.revision
    assert after.looked_at > before.looked_at


def test_scanner_on_which_another_program_fires_is_scanning(scanner):
    shown = view(scanner, status=heard(connection="in-use", laser="on", holder="steradian (process 7)"))
    assert (shown.state, shown.laser, shown.holder) == ("scanning", "on", "steradian (process 7)")
    assert shown.age < 1


def test_scanner_with_a_latched_fault_shows_it_until_it_is_cleared(scanner):
    scanner.note_status(heard(state="fault", fault=FAULT, error="it opened"))
    shown = view(scanner)
    assert (shown.state, shown.fault.name, shown.last_error) == ("fault", "interlock-opened", "it opened")
    scanner.note_status(heard())
    shown = view(scanner)
    assert (shown.state, shown.fault, shown.last_error) == ("idle", None, None)


def test_scanner_of_a_paused_scan_is_paused(scanner):
    scanner.note_state("paused")
    assert view(scanner, status=heard(state="paused")).state == "paused"
