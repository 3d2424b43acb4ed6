"""``steradian key`` and ``steradian worker`` as a person meets them."""

import re
from datetime import UTC, datetime, timedelta

import pytest

from steradian.security.keys import KeyStore, Scope, Unauthorized
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database
from steradian.storage.db.tables import ScannerRow
from support.commands import command as run


@pytest.fixture
def keys(tmp_path):
    database = Database(DataDirectory(tmp_path).metadata_url)
    yield KeyStore(database)
    database.close()


def test_a_key_is_shown_once_lets_its_owner_in_and_can_be_revoked(tmp_path, keys):
    made = run("key", "create", "Ada", "--scope", "plan", "--scope", "operate", "--data", tmp_path)
    key = made.stdout.strip()
    told = f"Ada may plan, operate, for ever; only a hash of the key is kept, by the service in {tmp_path}\n"
    assert (made.returncode, made.stderr) == (0, told)
    assert re.fullmatch(r"sk_[0-9a-f]+_[\w-]{40,}", key)
    principal = keys.check(key)
    assert (principal.scopes, "Ada" in principal.name) == ({Scope.PLAN, Scope.OPERATE}, True)
    listed = run("key", "list", "--data", tmp_path).stdout
    identifier = key.split("_")[1]
    assert re.search(rf"{identifier}\s+Ada\s+operate plan\s+valid", listed)
    assert key.split("_", 2)[2] not in listed
    assert "opens nothing any more" in run("key", "revoke", identifier, "--data", tmp_path).stderr
    listed = run("key", "list", "--data", tmp_path)
    assert "revoked" in listed.stdout
    assert listed.stderr == f"1 key of the service in {tmp_path}\n"
    with pytest.raises(Unauthorized):
        keys.check(key)


def test_key_create_defaults_to_read_scope_and_honours_expiry(tmp_path, keys):
    key = run("key", "create", "guest", "--days", "0.5", "--data", tmp_path).stdout.strip()
    assert keys.check(key).scopes == {Scope.READ}
    keys.clock = lambda: datetime.now(UTC) + timedelta(days=1)
    with pytest.raises(Unauthorized):
        keys.check(key)


def test_a_key_s_name_fits_where_it_will_be_written_down(tmp_path, keys):
    refused = run("key", "create", "a" * 101, "--data", tmp_path)
    assert (refused.returncode, "name" in refused.stderr, "1 to 100" in refused.stderr) == (2, True, True)
    longest = keys.check(run("key", "create", "a" * 100, "--data", tmp_path).stdout.strip())
    assert len(longest.name) <= ScannerRow.stopped_by.type.length


def test_invalid_scope_or_unknown_key_is_refused_with_message(tmp_path):
    wrong = run("key", "create", "Ada", "--scope", "everything", "--data", tmp_path)
    assert (wrong.returncode, wrong.stdout) == (2, "")
    assert "read, plan, operate, reconstruct, admin" in wrong.stderr.replace("\n", " ")
    unknown = run("key", "revoke", "nope", "--data", tmp_path)
    assert unknown.returncode == 3
    assert "no key 'nope'" in unknown.stderr
    assert "Traceback" not in wrong.stderr + unknown.stderr


def test_worker_without_database_url_exits_with_usage_error(tmp_path):
    refused = run("worker", "--data", tmp_path)
    assert refused.returncode == 2
    assert "STERADIAN_DATABASE_URL" in refused.stderr
    assert "steradian serve" in refused.stderr
    assert "Traceback" not in refused.stderr
