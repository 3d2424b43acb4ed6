"""What a first reconstruction needs is compiled while a scan runs, when a service begins, while an image is made."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import steradian
from steradian.reconstructions.warmup import SECOND_HALF, WARMUP_COMMAND
from support.commands import run_here
from support.services import Service
from support.waiting import until

pytestmark = pytest.mark.timeout(900)
ASKING = """
import time
from steradian.reconstructions.warmup import warmup_in_background
with warmup_in_background():
    time.sleep(300)
"""
LAST = {"depth.to_depth", "modes_to_image.compact_rows", "downsample.mean_pool"}
"""Functions that are compiled at the end of each half, and of both."""


class Fresh:
    """A copy of the package that nobody has used yet, for processes that begin from now on."""

    def __init__(self, folder):
        copy, self.kernels = folder / "copy", folder / "kernels"
        source = Path(steradian.__file__).parent
        shutil.copytree(source, copy / source.name, ignore=shutil.ignore_patterns("__pycache__"))
        self.environment = {"PYTHONPATH": str(copy), "NUMBA_CACHE_DIR": str(self.kernels)}

    def kept(self):
        """Files of compiled functions, and when they were written."""
        return {path: path.stat().st_mtime_ns for path in self.kernels.glob("**/*.nb[ic]")}

    def names(self):
        return {path.name.partition("-")[0] for path in self.kept()}

    def compiling(self):
        """Processes that are at it."""
        found = set()
        for process in Path("/proc").glob("[0-9]*"):
            try:
                told = process.joinpath("cmdline").read_bytes() + process.joinpath("environ").read_bytes()
            except OSError:  # it has ended, or is another user's
                continue
            if b"-m\0steradian.reconstructions.warmup" in told and os.fsencode(self.kernels) in told:
                found.add(process.name)
        return found


@pytest.fixture
def fresh(tmp_path, monkeypatch):
    fresh = Fresh(tmp_path)
    for name, value in fresh.environment.items():
        monkeypatch.setenv(name, value)
    return fresh


@pytest.fixture
def plan(tmp_path):
    run_here("mask", "equi-steradian", "--aperture", "4mm", "--depth", "2mm", "--count", "60", cwd=tmp_path)
    run_here("plan", "mask.json", "--samples", "256", cwd=tmp_path)


@pytest.mark.long
def test_service_start_precompiles_kernels_for_first_job(fresh, tmp_path):
    service = Service(tmp_path, simulator_speed=20.0).start()
    try:
        until(lambda: fresh.names() >= LAST and not fresh.compiling())
        kept = fresh.kept()
        scan = service.make("/scans", plan_id=service.plan())
        service.done("/reconstructions", scan_id=scan["id"], parameters={"modes": 24})
        assert fresh.kept() == kept
    finally:
        service.close()


@pytest.mark.nightly
def test_each_half_comes_to_its_end_alone(fresh):
    with subprocess.Popen([*WARMUP_COMMAND, SECOND_HALF], stdin=subprocess.PIPE) as second:
        assert second.wait() == 0
    assert fresh.names() >= LAST
    assert not any(name.startswith("type1.") for name in fresh.names())
    with subprocess.Popen(WARMUP_COMMAND, stdin=subprocess.PIPE) as first:
        assert first.wait() == 0
    assert {"type1.pack", "type1.type1"} <= fresh.names()


@pytest.mark.long
def test_concurrent_warmup_compiles_once_and_ends_with_its_parent(fresh):
    with subprocess.Popen([sys.executable, "-c", ASKING]) as asking:
        try:
            until(lambda: len(fresh.compiling()) == 2)  # a half each; the first has begun when it starts the second
            both = [int(process) for process in fresh.compiling()]
            for process in both:
                os.kill(process, signal.SIGSTOP)
            try:
                kept = fresh.kept()
                with subprocess.Popen(WARMUP_COMMAND, stdin=subprocess.PIPE) as another:
                    assert another.wait(200) == 0
                assert fresh.kept() == kept, "it leaves that to them"
            finally:
                for process in both:
                    os.kill(process, signal.SIGCONT)
        finally:
            asking.kill()
    until(lambda: not fresh.compiling(), 60)


@pytest.mark.long
@pytest.mark.parametrize(
    "words", ["scan run plan.json --simulator-speed 0.5", "reconstruct scan.h5"], ids=["scan", "image"]
)
def test_other_processes_compile_it_while_a_command_scans_or_makes_an_image_and_no_longer(fresh, plan, words, tmp_path):
    is_scan = words.startswith("scan")
    if not is_scan:
        run_here("scan", "run", "plan.json", "--simulator-speed", "1000", cwd=tmp_path)
        until(lambda: not fresh.compiling(), 30)
    command = [sys.executable, "-m", "steradian", *words.split()]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as made:
        until(lambda: fresh.compiling() or made.poll() is not None)
        assert made.poll() is None
        if not is_scan:
            made.kill()  # it would compile for ten seconds
        said, _ = made.communicate()
        assert made.returncode == (0 if is_scan else -signal.SIGKILL), said
    until(lambda: not fresh.compiling(), 60)
