"""Data folders of which a part belongs to another user, or that are read-only: one sentence, or reading alone."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys

import httpx
import pytest

from steradian.storage.data_dir.emergency_latch import EmergencyLatch
from support.kept import Kept
from support.rights import STRANGER, give_away, obeying, take_back
from support.services import Service
from support.waiting import until

PARTS = {
    "steradian.sqlite": "steradian.sqlite",
    "emergency-stop": "emergency-stop",
    "emergency-stop/pressed": "emergency-stop/pressed",
    "jobs": "jobs",
    "jobs/first": "jobs/first",
    "scans": "scans",
    "uploads": "uploads",
    "lock": "lock",
    "run": "run",
    ".": "",
}
CHECK = """
import sys
from pathlib import Path
from steradian.core.exceptions import FolderNotWritable
from steradian.storage.maintenance.permissions import require_writable
from steradian.storage.data_dir.layout import DataDirectory
for name in sys.argv[1:]:
    try:
        require_writable(DataDirectory(Path(name)))
        print("writable")
    except FolderNotWritable as error:
        print(error)
"""


@pytest.fixture
def kept(tmp_path):
    kept = Kept(tmp_path / "data")
    EmergencyLatch(kept.data.emergency)
    with kept.data.lock():
        pass
    return kept


def steradian(*words, **variables):
    """Run a command as a process that obeys owners and modes; it must end by itself."""
    settings = {f"STERADIAN_{name.upper()}": str(value) for name, value in variables.items()}
    command = obeying(sys.executable, "-m", "steradian", *words)
    return subprocess.run(command, env=os.environ | settings, capture_output=True, text=True, timeout=250)


def test_require_writable_with_a_part_of_another_user_names_part_owner_and_remedy(kept, tmp_path):
    folders = []
    for number, name in enumerate(PARTS):
        folders.append(tmp_path / f"copy {number}")
        shutil.copytree(kept.folder, folders[-1])
        (give_away if name != "." else lambda path: os.chown(path, STRANGER, STRANGER))(folders[-1] / name)
    told = subprocess.run(
        obeying(sys.executable, "-c", CHECK, kept.folder, *folders), capture_output=True, text=True, check=True
    ).stdout.splitlines()
    assert told[0] == "writable"
    for folder, name, line in zip(folders, PARTS.values(), told[1:], strict=True):
        assert line.startswith(
            f"{folder / name} belongs to {STRANGER} and cannot be written by this process's user root"
        )
        assert line.endswith(f"`chown -R root '{folder}'`, as root, mends it"), line


@pytest.mark.long
def test_require_writable_with_a_file_systems_own_folder_of_root_accepts_it(kept):
    for name in ("scans/lost+found", "jobs/@eaDir", "uploads/.snapshot"):
        folder = kept.folder / name
        folder.mkdir(parents=True)
        give_away(folder)
    ended = subprocess.run(obeying(sys.executable, "-c", CHECK, kept.folder), capture_output=True, text=True)
    assert ended.stdout == "writable\n", ended


@pytest.mark.parametrize("name", ["steradian.sqlite", "emergency-stop", "jobs"])
def test_serve_with_a_part_of_another_user_ends_with_one_line_and_exit_code_3(kept, name):
    give_away(kept.folder / name)
    ended = steradian("serve", "--port", "0", data=kept.folder)
    assert (ended.returncode, ended.stdout) == (3, "")
    assert ended.stderr.count("\n") == 1, ended.stderr
    assert f"error: {kept.folder / name} belongs to {STRANGER}" in ended.stderr


@pytest.mark.long
@pytest.mark.parametrize("command", ["api", "acquisition", "worker"])
def test_a_node_with_a_part_of_another_user_ends_with_one_line_and_exit_code_3(kept, command):
    give_away(kept.folder / "run")
    shared = {"database_url": "postgresql://127.0.0.1:1/none", "store": "s3://bucket", "node_secret": "s" * 40}
    ended = steradian(command, data=kept.folder, **shared)
    assert (ended.returncode, ended.stderr.count("\n")) == (3, 1), ended.stderr
    assert f"error: {kept.folder / 'run'} belongs to {STRANGER}" in ended.stderr


@pytest.mark.long
@pytest.mark.timeout(400)
def test_service_with_foreign_owned_jobs_folder_reports_it_and_recovers(tmp_path):
    service = Service(tmp_path / "data", log=tmp_path / "log")
    service.command = obeying(*Service.command)
    service.start()
    try:
        scan = service.make("/scans", plan_id=service.plan())
        ready = lambda: httpx.get(f"{service.url}/readyz", timeout=250)  # noqa: E731
        until(lambda: ready().status_code == 200)
        give_away(service.folder / "jobs")
        assert ready().status_code == 503
        assert ready().json()["reasons"]["folder"].startswith(f"jobs belongs to {STRANGER}")
        until(lambda: service.get(f"/scans/{scan['id']}").json()["state"] == "complete")
        asked = {"scan_id": scan["id"], "parameters": {"modes": 16}}
        job = service.http.post("/reconstructions", json=asked).raise_for_status().json()["id"]
        stage = lambda: service.get(f"/jobs/{job}").json()["progress"]["stage"] or ""  # noqa: E731
        until(lambda: f"jobs belongs to {STRANGER}" in stage())
        assert str(service.folder) not in stage(), "where the folder lies is nobody's business"
        take_back(service.folder / "jobs")
        until(lambda: service.get(f"/jobs/{job}").json()["state"] == "succeeded")
        assert ready().status_code == 200
        assert [start["outcome"] for start in service.get(f"/jobs/{job}/attempts").json()["items"]] == [
            "interrupted",
            "succeeded",
        ]
        worker = service.pid_of("worker-0")
        os.kill(worker, signal.SIGSTOP)
        closed = service.http.post("/reconstructions", json=asked).raise_for_status().json()["id"]
        (service.folder / "jobs" / closed).mkdir()
        give_away(service.folder / "jobs" / closed)
        os.kill(worker, signal.SIGCONT)
        until(lambda: service.get(f"/jobs/{closed}").json()["ended"])
        error = service.get(f"/jobs/{closed}").json()["error"]
        assert error["code"] == "folder-not-writable"
        assert error["detail"].startswith(f"its folder cannot be written: jobs/{closed} belongs to {STRANGER}")
    finally:
        service.close()


@pytest.mark.long
def test_a_service_of_which_a_process_ends_for_a_part_of_another_user_ends_with_that_sentence(tmp_path):
    """It would be started again and again, and requests wait on a port that nobody answers."""
    service = Service(tmp_path / "data", log=tmp_path / "log")
    service.command = obeying(*Service.command)
    service.start()
    try:
        give_away(service.folder / "emergency-stop")
        os.kill(service.pid_of("api"), signal.SIGKILL)
        assert service.process.wait(250) == 3
        told = f"error: {service.folder / 'emergency-stop'} belongs to {STRANGER}"
        assert len([line for line in service.log.read_text().splitlines() if line.startswith(told)]) == 1
    finally:
        service.close()


@pytest.fixture(params=["another user's", "file system"])
def read_only(kept, request, tmp_path):
    """A data folder that can be read, not written."""
    if request.param == "another user's":
        give_away(kept.folder)
        yield kept.folder
        return
    mount, options = tmp_path / "mount", "ro,bind"
    mount.mkdir()
    obeying()
    if subprocess.run(["mount", "-o", "bind", kept.folder, mount], capture_output=True).returncode:
        pytest.skip("needs the right to mount: in a container --cap-add SYS_ADMIN")
    try:
        subprocess.run(["mount", "-o", f"remount,{options}", mount], check=True)
        yield mount
    finally:
        subprocess.run(["umount", "-l", mount], check=True)


@pytest.mark.long
def test_commands_that_read_work_on_a_folder_that_cannot_be_written(read_only):
    shown = steradian("storage", "show", "--data", read_only)
    assert (shown.returncode, "free on the disk" in shown.stdout) == (0, True), shown.stderr
    listed = steradian("key", "list", "--data", read_only)
    assert (listed.returncode, listed.stderr) == (0, f"0 keys of the service in {read_only}\n")
    for words in (("key", "create", "Ada"), ("storage", "delete", "job", "first")):
        refused = steradian(*words, "--data", read_only)
        assert refused.returncode != 0
        assert refused.stderr.count("\n") == 1, refused.stderr
    ended = steradian("serve", "--port", "0", data=read_only)
    assert (ended.returncode, ended.stderr.count("\n")) == (3, 1), ended.stderr


@contextlib.contextmanager
def unchanged(folder):
    def look():
        return {
            str(path): (path.lstat().st_mode, path.lstat().st_mtime_ns, path.read_bytes() if path.is_file() else b"")
            for path in (folder, *sorted(folder.rglob("*")))
        }

    before = look()
    yield
    assert look() == before


@pytest.mark.long
def test_serve_on_folder_with_foreign_scans_leaves_it_unchanged(tmp_path):
    from steradian.core.exceptions import DamagedFile
    from steradian.core.settings import Settings
    from steradian.runtime.supervisor import run_service

    folder = tmp_path / "mine"
    (folder / "scans").mkdir(parents=True, mode=0o755)
    for path in (folder, folder / "scans"):
        path.chmod(0o755)
    (folder / "scans" / "brain.h5").write_bytes(b"of a person")
    (folder / "notes.txt").write_text("of a person")
    with unchanged(folder), pytest.raises(DamagedFile, match=r"is missing, but there are 1 scan"):
        run_service(Settings.create(data=folder, port=0), print, None)
    (folder / "steradian.sqlite").write_text("no database")
    with unchanged(folder), pytest.raises(DamagedFile, match="is not an SQLite database"):
        run_service(Settings.create(data=folder, port=0), print, None)


def test_serve_with_a_folder_path_longer_than_sqlite_opens_is_refused_before_it_is_made(tmp_path):
    from steradian.core.exceptions import InvalidInput
    from steradian.core.settings import Settings
    from steradian.runtime.supervisor import run_service

    folder = tmp_path.joinpath(*["x" * 100] * 5)
    with pytest.raises(InvalidInput, match=r"at most 487 bytes, for SQLite \(it has \d+\)"):
        run_service(Settings.create(data=folder, port=0), print, None)
    assert not (tmp_path / ("x" * 100)).exists()
