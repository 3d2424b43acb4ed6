"""The command steradian-client against a real service, and the example that people begin with."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from steradian_client.cli import main
from steradian_client.config import Address, config_file
from support import recordings

pytestmark = pytest.mark.long

CLIENT = Path(__file__).parents[2] / "clients" / "python"


@pytest.fixture
def run(url, monkeypatch, capsys):
    """Runs a command; returns what it printed, read as JSON where it is."""
    monkeypatch.setenv("STERADIAN_URL", url)

    def run(*words):
        monkeypatch.setattr(sys, "argv", ["steradian-client", *map(str, words)])
        with pytest.raises(SystemExit) as end:
            main()
        out, run.err = capsys.readouterr()
        assert end.value.code in {None, 0}, (end.value.code, run.err)
        return json.loads(out) if "--json" in words else out

    return run


@pytest.mark.long
def test_the_main_job_from_a_shell(run, tmp_path):
    """Each answer is JSON that the next command is made from; progress does not get into it."""
    mask = run("mask", "create", "equi-steradian", "aperture=13.56e-3", "depth=3.6e-3", "count=60", "--json")
    plan = run("plan", "create", mask["id"], "samples=256", "--json")
    scan = run("scan", "create", plan["id"], "phantom=yarn", "--wait", "--json")
    assert (scan["state"], scan["labels"]) == ("complete", {"phantom": "yarn"})
    assert "A-lines" in run.err
    job = run("reconstruction", "create", scan["id"], "modes=24", "--json")
    assert run("job", "watch", job["id"], "--json")["state"] == "succeeded"
    run("reconstruction", "volume", job["id"], tmp_path / "volume.npy")
    assert np.load(tmp_path / "volume.npy").shape == (24, 24, 256)
    run("scan", "file", scan["id"], tmp_path / "scan.h5")
    assert (tmp_path / "scan.h5").read_bytes()[1:4] == b"HDF"
    assert scan["id"] in run("scan", "list")
    assert "complete" in run("scan", "show", scan["id"])
    assert run("reconstruction", "list", "--json")[0]["id"] == job["id"]
    assert json.loads(run("events", "--count", "1"))["kind"] == "ready"
    run("reconstruction", "delete", job["id"])
    assert job["id"] not in run("reconstruction", "list")


def test_lists_are_filtered_by_options(run):
    made = run("mask", "create", "grid", "aperture=0.01", "count=3", "interval=1.7e-3", "--json")  # nobody else's
    plan = run("plan", "create", made["id"], "samples=200", "--json")
    assert [one["id"] for one in run("plan", "list", "--mask", made["id"], "--json")] == [plan["id"]]
    scan = run("scan", "create", plan["id"], "phantom=leaf", "--json")
    chosen = ("--label", "phantom=leaf", "--label", "phantom", "--mask", made["id"], "--json")
    assert [one["id"] for one in run("scan", "list", *chosen)] == [scan["id"]]
    assert run("scan", "list", "--state", "failed", "--state", "aborted", *chosen) == []
    assert run("job", "list", "kind=export", "--scan", scan["id"], "--json") == []


@pytest.mark.parametrize("words", [("state=queued", "--state", "running"), ("limit=5",)])
def test_cli_list_option_passed_as_filter_exits_2(monkeypatch, capsys, words):
    monkeypatch.setattr(sys, "argv", ["steradian-client", "--url", "http://127.0.0.1:9", "job", "list", *words])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    assert "is an option" in capsys.readouterr().err


def test_the_emergency_stop_is_one_command(run):
    stop = run("scanner", "stop", "--reason", "smoke", "--json")
    assert stop["reason"] == "smoke"
    assert "smoke" in run("scanner", "list")
    assert run("scanner", "release", "--number", stop["number"], "--json")["emergency_stop"] is None


def test_a_refusal_is_one_line_and_a_status(url):
    """What the service says of it is all that is said, and no traceback."""
    command = [sys.executable, "-m", "steradian_client", "--url", url, "plan", "create", "m0"]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=250)
    assert ran.returncode == 1
    assert re.fullmatch(r"error: .*m0.*\(404 not-found\)\n", ran.stderr)


def test_address_and_key_are_found(tmp_path):
    """What is given counts before the environment, and that before the file; no key goes to another's address."""
    there = {"XDG_CONFIG_HOME": str(tmp_path), "APPDATA": str(tmp_path)}
    assert Address.resolve(environment=there) == Address("http://127.0.0.1:8000", None)
    config_file(there).parent.mkdir()
    config_file(there).write_text('url = "http://lab:8000"\nkey = "from file"\n')
    assert Address.resolve(environment=there) == Address("http://lab:8000", "from file")
    assert Address.resolve("http://other:1", environment=there) == Address("http://other:1", None)
    there |= {"STERADIAN_URL": "http://here:9", "STERADIAN_KEY": "from environment"}
    assert Address.resolve(environment=there) == Address("http://here:9", "from environment")
    assert Address.resolve("http://other:1", environment=there) == Address("http://other:1", None)
    assert Address.resolve("http://other:1", "given", environment=there) == Address("http://other:1", "given")


@pytest.mark.long
def test_the_example_finds_its_ball(url):
    """Under thirty lines from own data to volumes with axes: depth as said, amplitude as much as the square sees."""
    script = CLIENT / "examples" / "own_data.py"
    assert len(script.read_text().splitlines()) < 30
    environment = os.environ | {"STERADIAN_URL": url}
    ran = subprocess.run([sys.executable, script], env=environment, capture_output=True, text=True, timeout=300)
    assert ran.returncode == 0, ran.stderr
    found = {
        method: [float(number) for number in numbers]
        for method, *numbers in re.findall(r"(\w+): (\S+) at (\S+), (\S+), (\S+) mm", ran.stdout)
    }
    for numbers in found.values():
        assert np.abs(np.array(numbers[1:]) - (0, 0, 3.0)).max() < 0.05
    half = 2.4  # of the square; its share of the half space below the ball
    seen = 2 / np.pi * np.arcsin(half**2 / (half**2 + 3.0**2))
    assert found["nedner"][0] == pytest.approx(seen, abs=0.03)
    assert found["iterative"][0] > found["nedner"][0], "the iterative image fills in what the aperture does not see"


@pytest.mark.long
@pytest.mark.timeout(400)
def test_the_same_in_a_shell(url, tmp_path):
    """The command alone: own data in, volumes with their axes out, under thirty lines too."""
    script = CLIENT / "examples" / "own_data.sh"
    assert len(script.read_text().splitlines()) < 30
    recordings.save(tmp_path / "own.npz")
    found = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    environment = os.environ | {"STERADIAN_URL": url, "PATH": found}
    ran = subprocess.run(
        [script, "own.npz"], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=380
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    recordings.expect_the_ball(tmp_path)


def test_scanner_show_and_clear_fault_without_a_fault_print_the_scanner(run):
    for words in (("scanner", "show"), ("scanner", "clear-fault", "--reason", "closed again")):
        shown = run(*words, "--json")
        assert (shown["id"], shown["fault"]) == ("scanner-0", None)
        assert shown["laser"] in {"off", "unknown"}
