"""What a file can do that takes over its reader: next to nothing."""

import ctypes
import json
import os
import socket
import sys
from pathlib import Path

import pytest

from steradian.core.exceptions import DamagedFile, InvalidInput
from steradian.core.sandbox import minimal_environment
from steradian.scans.importing import sandbox

sys.path.insert(0, str(Path(__file__).parent))
import foreign

SECRETS = ("STERADIAN_API_KEY", "STERADIAN_DATABASE_URL", "PGPASSWORD", "AWS_SECRET_ACCESS_KEY")
ALLOWED = {"the recording", "own folder"}
BOUND = {"a hundred files", "a file larger than the disk"}
"""What limits of a process refuse, and a Landlock does not."""


def _landlock():
    """Version of the kernel's Landlock; 0 or less when there is none."""
    return (
        ctypes.CDLL(None).syscall(444, None, ctypes.c_size_t(0), ctypes.c_uint32(1)) if sys.platform == "linux" else 0
    )


@pytest.fixture
def data(tmp_path, monkeypatch):
    """A data folder with secrets around it, in a process that knows passwords."""
    for name in SECRETS:
        monkeypatch.setenv(name, f"secret-{name}")
    data = tmp_path / "data"
    for path in ("scans/other.h5", "steradian.sqlite", "../private"):
        (data / path).parent.mkdir(parents=True, exist_ok=True)
        (data / path).write_bytes(b"secret")
    return data


@pytest.fixture
def listener():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield listener


def import_hostile(data, listener, monkeypatch, *mode):
    """Have a recording read by the hostile reader; returns what that could do, and its out-of-memory score."""
    places = {
        "database": str(data / "steradian.sqlite"),
        "scan": str(data / "scans" / "other.h5"),
        "scans": str(data / "scans"),
        "private": str(data.parent / "private"),
        "port": listener.getsockname()[1],
        "secrets": SECRETS,
    }
    (data.parent / "places.json").write_text(json.dumps(places))
    reader = str(Path(__file__).with_name("hostile_reader.py"))
    monkeypatch.setattr(sandbox, "COMMAND", (sys.executable, "-P", reader, str(data.parent / "places.json"), *mode))
    source = data / "upload"
    source.write_bytes(b"a recording")
    with pytest.raises(InvalidInput) as said:
        sandbox.import_in_sandbox(source, data / "scans" / "new.h5")
    assert sorted(path.name for path in (data / "scans").iterdir() if path.name != "forged.h5") == ["other.h5"]
    return set(json.loads(said.value.value)), said.value.allowed


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="what a process may do is Linux's")
def test_without_landlock_limits_and_a_poor_environment_remain(data, listener, monkeypatch):
    """What the reader could do before it was shut in; it is what remains where the kernel cannot do that."""
    done, score = import_hostile(data, listener, monkeypatch, "free")
    assert "environment" not in done
    assert not done & BOUND
    assert done >= ALLOWED | {"database", "another scan", "forged scan", "private file", "program", "connection"}
    assert "environment of the parent" in done, "so that this is what shutting in is for"
    assert score == "1000", "when memory runs out it goes first"


@pytest.mark.skipif(_landlock() < 1, reason="this kernel has no Landlock")
def test_a_reader_that_is_taken_over_has_its_recording_and_its_folder(data, listener, monkeypatch):
    done, _ = import_hostile(data, listener, monkeypatch)
    unbound = {"another thread"} if os.geteuid() == 0 else set()
    later = ({"connection"} if _landlock() < 4 else set()) | ({"signal to the parent"} if _landlock() < 6 else set())
    assert done - unbound - later == ALLOWED


def test_an_environment_for_strangers_holds_nothing_that_is_not_known_to_be_harmless(tmp_path):
    given = {"PATH": "/bin", "LC_ALL": "C", "HOME": "/home/ada"} | dict.fromkeys(SECRETS, "secret")
    expected = {"PATH": "/bin", "LC_ALL": "C", "HOME": str(tmp_path), "TMPDIR": str(tmp_path)}
    assert minimal_environment(given, tmp_path) == expected


def test_a_link_in_the_place_of_a_scan_is_no_scan(tmp_path, monkeypatch):
    """A reader that leaves a link would have another file served as its scan."""
    source, description = foreign.npy_time_first(tmp_path)
    (tmp_path / "secret").write_bytes(b"secret")
    program = tmp_path / "reader.py"
    program.write_text(f"""
import json, os, sys
path = json.loads(sys.stdin.readline())["paths"][1]
os.symlink({str(tmp_path / "secret")!r}, path)
print(json.dumps({{"result": {{"format": "x", "points": 1, "samples": 1}}}}), flush=True)
""")
    monkeypatch.setattr(sandbox, "COMMAND", (sys.executable, "-P", str(program)))
    with pytest.raises(DamagedFile, match="left no file"):
        sandbox.import_in_sandbox(source, tmp_path / "scan.h5", description=description)
    assert not (tmp_path / "scan.h5").exists()
