"""``python -m fabry_perot``, run as a person runs it, against a simulated scanner in a process of its own."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import fabry_perot
from fabry_perot import TuningMap
from fabry_perot.simulator import launch
from support import copies

EXACT = {"noise_db": float("inf"), "energy_jitter": 0.0, "seed": 2}


@pytest.fixture(scope="module", params=["terminal", "tcp"])
def simulator(request):
    where = {"tcp": "127.0.0.1:0"} if request.param == "tcp" else {}
    with launch(speed=20, **where, **EXACT) as running:
        yield running


def run(*words, cwd, code=0):
    """Run a command; returns standard output, and standard error too when it is to fail."""
    command = [sys.executable, "-m", "fabry_perot", *map(str, words)]
    done = copies.run(command, cwd=cwd)
    assert done.returncode == code, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    return done.stdout if code == 0 else done.stdout + done.stderr


def points_of(tmp_path, count=40):
    where = np.random.default_rng(0).uniform(-6, 6, (count, 2)).round(3)
    np.savetxt(tmp_path / "points.csv", where, delimiter=",", header="x_mm,y_mm", comments="", fmt="%.3f")
    return where * 1e-3


@pytest.mark.long
def test_list_command_shows_scanner_and_port_holder(simulator, tmp_path):
    said = run("list", simulator.url, tmp_path / "nothing", "--probe", cwd=tmp_path)
    nothing = f"{tmp_path / 'nothing'}\tcannot open {tmp_path / 'nothing'}: no such file; is the scanner"
    assert said.startswith(f"{simulator.url}\tsimulated Fabry-Perot scanner SIM-0002\n{nothing}")
    with fabry_perot.connect(simulator.url):
        busy = run("list", simulator.url, "--probe", cwd=tmp_path)
        who = "is connected: 127.0.0.1" if simulator.url.startswith("socket:") else f"(process {os.getpid()})"
        assert busy.startswith(f"{simulator.url}\tbusy: ")
        assert who in busy
        assert re.search("is connected|in use by", run("status", simulator.url, cwd=tmp_path, code=1))


def test_status_command_shows_scanner_status(simulator, tmp_path):
    figures = json.loads(run("status", simulator.url, "--json", cwd=tmp_path))
    with fabry_perot.connect(simulator.url) as scanner:
        assert figures["serial"] == scanner.capabilities.serial
        assert figures["samples"] == list(scanner.capabilities.samples)
    assert figures["shots"] == simulator.send_command("report")["shots"]
    assert re.search(r"^state +linked|^state +ready|^state +done", run("status", simulator.url, cwd=tmp_path), re.M)


def test_watch_shows_a_line_each_time(simulator, tmp_path):
    lines = run("watch", simulator.url, "--count", 3, "--interval", 0.01, cwd=tmp_path).splitlines()
    assert len(lines) == 3
    assert all("shots" in line and "laser" in line for line in lines)


def test_tune_command_saves_map_equal_to_library_map(simulator, tmp_path):
    where = points_of(tmp_path, 3)
    run("tune", simulator.url, "--points", "points.csv", "--steps", 41, "-o", "map.npz", cwd=tmp_path)
    kept = TuningMap.load(tmp_path / "map.npz")
    with fabry_perot.connect(simulator.url) as scanner:
        again = scanner.pretune(where, steps=41)
    np.testing.assert_allclose(kept.points, where, atol=1e-12)
    np.testing.assert_allclose(kept.wavelength, again.wavelength, atol=20e-12)


def test_scan_command_output_file_equals_library_scan(simulator, tmp_path):
    where = points_of(tmp_path)
    said = run("scan", simulator.url, "points.csv", "--samples", 300, "--rate", 100, cwd=tmp_path)
    assert "40 of 40 A-lines in scan.npy" in said
    rows = np.load(tmp_path / "scan.npy", allow_pickle=False)
    assert rows["stored"].all()
    np.testing.assert_allclose(np.column_stack([rows["x"], rows["y"]]), where, atol=1e-12)
    with fabry_perot.connect(simulator.url) as scanner:
        scanner.upload(where, samples=300, sampling_interval=8e-9, pulse_rate=100.0)
        scanner.start(scanner.arm())
        lines = []
        for batch in scanner.alines():
            lines += batch
            scanner.acknowledge(batch[-1])
    np.testing.assert_array_equal(rows["samples"], [line.samples for line in lines])
    np.testing.assert_allclose(rows["scale"], [line.scale for line in lines])
    assert "allowed" in run("scan", simulator.url, "points.csv", cwd=tmp_path, code=1), "the file exists"


@pytest.mark.long
def test_scan_command_sigint_turns_laser_off_and_keeps_every_shot(tmp_path):
    points_of(tmp_path, 2000)
    with launch(speed=1.0, **EXACT) as simulator:
        command = [sys.executable, "-m", "fabry_perot", "scan", simulator.url, "points.csv", "--samples", "64"]
        heard = signal.signal(signal.SIGINT, signal.default_int_handler)  # tests in the background have it ignored
        process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        signal.signal(signal.SIGINT, heard)
        try:
            deadline = time.monotonic() + 60
            while simulator.send_command("report")["shots"] < 20:
                assert time.monotonic() < deadline
                time.sleep(0.02)
            process.send_signal(signal.SIGINT)
            said, errors = process.communicate(timeout=250)
        finally:
            process.kill()
            process.wait()
        account = simulator.send_command("report")
    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    stored = int(re.search(r"laser off; (\d+) of 2000 A-lines", said)[1])
    assert account["state"] == "safe_hold"
    assert stored == account["shots"] == np.load(tmp_path / "scan.npy")["stored"].sum()


@pytest.mark.long
def test_monitor_shows_the_frames_of_both_directions(simulator, tmp_path):
    said = run("monitor", simulator.url, "--seconds", 0.5, cwd=tmp_path)
    for words in ("> HELLO ", "< HELLO_ACK ", "> CAPS ", "< CAPS_PIECE ", "< STATUS ", "acknowledged="):
        assert words in said
    assert "damaged" not in said
    points_of(tmp_path, 5)
    command = [sys.executable, "-m", "fabry_perot", "scan", simulator.url, "points.csv", "--frames"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=250)
    for words in ("operation=ARM result=OK", "operation=START", "> PLAN_DATA ", "< ALINE ", "> ALINE_ACK "):
        assert words in done.stderr
    assert done.returncode == 0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["status", "/nowhere"], "cannot open /nowhere"),
        (["scan", "/nowhere", "none.csv"], "none.csv"),
        (["scan", "/nowhere", "text.csv"], "two columns of numbers"),
        (["tune", "/nowhere", "--points", "line.npy"], "shape (3,)"),
    ],
)
def test_driver_command_error_prints_one_line(words, said, tmp_path):
    (tmp_path / "text.csv").write_text("x,y\nno,number\n")
    np.save(tmp_path / "line.npy", np.zeros(3))
    errors = run(*words, cwd=tmp_path, code=1)
    assert said in errors
    assert len(errors.splitlines()) == 1


def test_the_driver_runs_without_the_rest_of_the_repository(tmp_path):
    """No module of Steradian and no HDF5 is loaded by any command's module."""
    code = "import sys, fabry_perot.__main__; print({'steradian', 'h5py'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=os.environ, check=True)
    assert done.stdout == "set()\n"
