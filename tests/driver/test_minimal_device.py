"""The device in C, written after the document: conformance, our own host, and defects of its own."""

from __future__ import annotations

import shutil
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import fabry_perot
from fabry_perot.conformance import SCENARIOS, ConformanceHost, run
from fabry_perot.host.transport import open_transport

SOURCE = Path(__file__).parents[2] / "driver" / "examples" / "minimal-device"
NAMES = [scenario.run.__name__ for scenario in SCENARIOS]
DEFECTS = {
    "an echo of the future counts": ("echo > d->now", "0", "future_echo"),
    "the lease counts from arrival": (
        "echo + (ttl < CAP ? ttl : CAP)",
        "d->now + (ttl < CAP ? ttl : CAP)",
        "stale_echo",
    ),
    "no credit is needed": ("d->sent < d->limit", "1", "credit"),
    "a full ring is overwritten": ("if (fill(d) >= RING)", "if (0)", "full_ring"),
    "the shutter stays open": ("{ d->shutter = 0; }", "{ (void)d; }", "lease_expiry"),
    "a gap in the plan is accepted": (
        "if (first + i == d->expected &&",
        "if (first + i >= d->expected &&",
        "plan_gaps",
    ),
    "a gate that is not there is taken": ("data[10 + 16 * i + 14] & 8", "0", "gate"),
    "a fault is cleared whatever its cause": ("!cause_stands(d) && ", "", "interlock"),
    "sessions are not checked": ("f->session == d->session &&", "", "session"),
    "checksums are not checked": ("crc32c(d->body, size - 4) !=", "0 * crc32c(d->body, 1) > 0 * ", "checksum"),
}


def build(folder: Path, source: Path = SOURCE) -> Path:
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("no C compiler: install gcc (or cc, clang) to build driver/examples/minimal-device")
    program = folder / "minimal-device"
    files = [source / name for name in ("wire.c", "device.c", "main.c")]
    subprocess.run([compiler, "-std=c11", "-O2", "-Wall", "-Wextra", "-o", program, *files], check=True, timeout=250)
    return program


@pytest.fixture(scope="module")
def program(tmp_path_factory) -> Path:
    return build(tmp_path_factory.mktemp("device"))


@contextmanager
def running(program: Path) -> Iterator[subprocess.Popen]:
    with subprocess.Popen([program], stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def conform(program: Path, *only: str) -> dict[str, str]:
    with running(program) as process:
        transport = open_transport(process.stdout.readline().strip())

        def ask(wish: str) -> None:
            wanted = {"open the interlock": signal.SIGUSR1, "close the interlock": signal.SIGUSR2}
            process.send_signal(wanted.get(wish, signal.SIGHUP))

        try:
            outcomes = run(ConformanceHost(transport), ask=ask, only=only)
        finally:
            transport.close()
    return {outcome.name: outcome.failure or outcome.skipped for outcome in outcomes}


@pytest.mark.long
def test_a_device_that_shares_no_code_with_ours_conforms(program):
    assert conform(program) == dict.fromkeys(NAMES, "")


@pytest.mark.long
@pytest.mark.mutants
@pytest.mark.parametrize("name", DEFECTS)
def test_a_defect_of_that_device_fails_the_scenario_made_for_it(name, tmp_path):
    right, wrong, scenario = DEFECTS[name]
    shutil.copytree(SOURCE, tmp_path / "source")
    found = [path for path in (tmp_path / "source").glob("*.c") if right in path.read_text()]
    assert len(found) == 1
    found[0].write_text(found[0].read_text().replace(right, wrong))
    assert conform(build(tmp_path, tmp_path / "source"), scenario)[scenario].startswith("expected: ")


def test_our_host_scans_it_to_the_last_sample(program):
    """Its samples are 37·point + 11·k; the plan is longer than its memory, the ring shorter than the scan."""
    points = np.column_stack([np.linspace(-4e-3, 4e-3, 300), np.zeros(300)])
    lines: list = []
    with running(program) as process, fabry_perot.connect(process.stdout.readline().strip()) as scanner:
        scanner.upload(points, samples=700, sampling_interval=8e-9, pulse_rate=1000.0, averages=2)
        scanner.start(scanner.arm())
        while len(lines) < 300:
            try:
                for batch in scanner.alines():
                    lines += batch
                    scanner.acknowledge(batch[-1])
            except fabry_perot.LeaseExpired:  # this machine was busy with something else
                scanner.resume()
        report = scanner.report()
    assert [line.point for line in lines] == list(range(300))
    for line in lines:
        assert np.array_equal(line.samples, 37 * line.point + 11 * np.arange(700))
        assert line.averages == 2
    assert report.stored == 300
    assert report.fired == 600 + report.wasted
