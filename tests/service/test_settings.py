from pathlib import Path

import pytest

from steradian.core.exceptions import InvalidInput
from steradian.core.settings import Settings


def test_environment_variable_sets_only_settings_not_given(monkeypatch):
    monkeypatch.setenv("STERADIAN_PORT", "9000")
    monkeypatch.setenv("STERADIAN_WORKERS", "3")
    settings = Settings.create(data=Path("here"), workers=2, host=None)
    assert (settings.port, settings.workers, settings.host) == (9000, 2, "127.0.0.1")


@pytest.mark.parametrize(
    ("field", "value", "allowed"),
    [("port", 70_000, "at most 65535"), ("workers", -1, "at least 0"), ("simulator_speed", 0, "> 0")],
)
def test_a_setting_out_of_range_is_named_with_its_range(field, value, allowed):
    with pytest.raises(InvalidInput, match=f"{field} is {value}; allowed: .*{allowed}"):
        Settings.create(data=Path("here"), **{field: value})


def test_a_store_needs_a_database_that_every_host_can_reach():
    with pytest.raises(InvalidInput, match="store is s3://bucket; allowed: none without STERADIAN_DATABASE_URL"):
        Settings.create(data=Path("here"), store="s3://bucket")
    settings = Settings.create(data=Path("here"), store="s3://bucket/some/where", database_url="postgresql://host/rows")
    assert settings.store == "s3://bucket/some/where"


@pytest.mark.parametrize("store", ["https://bucket", "s3://", "s3://Bucket", "s3://key:secret@bucket", "bucket"])
def test_a_store_is_a_bucket_and_holds_no_key(store):
    with pytest.raises(InvalidInput, match="store is"):
        Settings.create(data=Path("here"), store=store, database_url="postgresql://host/rows")


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("api_key", "swordfish"),
        ("database_url", "mysql://lab:swordfish@host/rows"),
        ("store", "s3://lab:swordfish@bucket"),
        ("store_endpoint", "https://lab:swordfish@host"),
        ("store_endpoint", "ftp://host?token=swordfish"),
    ],
)
def test_refused_secret_setting_is_not_echoed_in_message(field, value):
    """The message ends in terminals, logs and tickets."""
    with pytest.raises(InvalidInput, match=f"^{field} is .*; allowed: ") as refused:
        Settings.create(data=Path("here"), **{field: value})
    assert "swordfish" not in str(refused.value)


def test_a_child_process_reads_the_very_same_settings(monkeypatch):
    settings = Settings.create(data=Path("here"), port=1234, scanner="/dev/ttyUSB3", simulator_speed=7.5)
    for name, value in settings.environment().items():
        if name.startswith("STERADIAN_"):
            monkeypatch.setenv(name, value)
    assert Settings.create() == settings
    assert not settings.simulated


@pytest.mark.parametrize("host", ["LOCALHOST", "Localhost", "localhost", "127.0.0.2", "::1", "0:0:0:0:0:0:0:1"])
def test_any_name_of_the_loopback_is_the_loopback(tmp_path, host):
    assert not Settings.create(data=tmp_path, host=host).needs_key


@pytest.mark.parametrize("host", ["::", "127.evil.example", "localhost.evil.example", "192.0.2.1", "lab-pc"])
def test_no_other_name_is_the_loopback(tmp_path, host):
    assert Settings.create(data=tmp_path, host=host).needs_key
