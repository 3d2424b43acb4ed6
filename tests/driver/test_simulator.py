"""Real processes over real ports: what a user of the driver meets."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from driver_collected import collect

import fabry_perot
from fabry_perot.simulator import launch, phantoms
from fabry_perot.simulator.signal_path import peak_pressure

PARAMETERS = {"samples": 600, "sampling_interval": 8e-9, "pulse_rate": 50.0}


def points(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-6e-3, 6e-3, (count, 2)).round(6)


def scan(scanner, where, **changes) -> list:
    scanner.upload(where, **{**PARAMETERS, **changes})
    scanner.start(scanner.arm())
    return collect(scanner)


def recomputed(line, where, *, seed: int) -> np.ndarray:
    """The counts of an A-line from phantom, position, seed and shot number, as the simulator's documentation says."""
    balls = phantoms.yarn(seed)
    times = np.arange(len(line.samples)) * 8000e-12
    position = np.rint(where[line.point] * 1e9) * 1e-9
    clean = phantoms.pressure(balls, position, times, 1500.0)[0].astype(float)
    rms = strongest(seed) * 10 ** (-30.0 / 20)
    total = np.zeros(len(clean))
    for shot in range(line.shot - line.averages + 1, line.shot + 1):
        random = np.random.default_rng([seed, shot])
        energy = 1 + 0.01 * random.standard_normal()
        total += clean * energy + rms * random.standard_normal(len(clean), dtype=np.float32).astype(float)
    return np.clip(np.rint(total / (line.averages * line.scale)), -32768, 32767).astype(np.int16)


@cache
def strongest(seed: int) -> float:
    return peak_pressure(phantoms.yarn(seed), 1500.0)


@pytest.mark.long
@pytest.mark.parametrize("tcp", [None, "127.0.0.1:0"])
def test_a_scan_over_a_real_port_is_bit_exact(tcp):
    where = points(150)
    with launch(speed=50, seed=3, tcp=tcp) as simulator, fabry_perot.connect(simulator.url) as scanner:
        assert scanner.capabilities.simulated
        lines = scan(scanner, where)
        statistics = scanner.statistics()
    assert [line.number for line in lines] == [line.point for line in lines] == list(range(150))
    for line in lines:
        assert np.array_equal(line.samples, recomputed(line, where, seed=3))
        assert line.quality == 0
        assert line.sampling_interval == pytest.approx(8e-9)
    assert statistics["shots"] == 150 == statistics["acknowledged"]
    assert statistics["bad_frames"] == statistics["host_bad_frames"] == 0


def test_without_noise_an_a_line_is_the_phantoms_pressure_within_one_count_and_the_pulse_energy():
    where = points(40)
    with (
        launch(speed=100, noise_db=float("inf"), sound_speed=1480.0) as simulator,
        fabry_perot.connect(simulator.url) as scanner,
    ):
        lines = scan(scanner, where, averages=4)
    times = np.arange(600) * 8e-9
    truth = phantoms.pressure(phantoms.yarn(0), where, times, 1480.0)
    for line in lines:
        assert np.abs(line.samples * line.scale / line.energy - truth[line.point]).max() < 1.5 * line.scale
        assert line.averages == 4
    most = max(np.abs(line.samples).max() for line in lines)
    assert 0.2 * 32767 < most < 0.7 * 32767, "the gain uses about half of full scale"


def test_digitiser_trigger_delay_is_reported_per_aline_to_100_ps():
    """12 µs are 18 mm: time zero must not be limited to a few microseconds."""
    where, begins = points(10), 12.3456e-6
    with (
        launch(speed=100, noise_db=float("inf"), time_zero=begins) as simulator,
        fabry_perot.connect(simulator.url) as scanner,
    ):
        lines = scan(scanner, where)
    times = begins + np.arange(600) * 8e-9
    truth = phantoms.pressure(phantoms.yarn(0), where, times, 1500.0)
    for line in lines:
        assert line.time_zero_offset_s == pytest.approx(begins, abs=1e-12)
        assert np.abs(line.samples * line.scale / line.energy - truth[line.point]).max() < 1.5 * line.scale


def test_the_pulse_rate_sets_the_time_between_shots():
    with launch(speed=50) as simulator, fabry_perot.connect(simulator.url) as scanner:
        lines = scan(scanner, points(30))
    fired = np.array([line.fire_time_s for line in lines])
    assert np.diff(fired) == pytest.approx(0.02, abs=5e-6)


def test_simulated_uart_limits_rate_to_baud_without_loss():
    where = points(12)
    with launch(speed=20, baud=921_600) as simulator, fabry_perot.connect(simulator.url) as scanner:
        limit = scanner.capabilities.alines_per_second(600)
        lines = scan(scanner, where)
        took = scanner.status.device_time * 1e-6 - lines[0].fire_time_s
    assert 50 < limit < 80
    assert len(lines) == 12
    assert took > 0.8 * 12 * 1256 / 92160
    assert all(np.array_equal(line.samples, recomputed(line, where, seed=0)) for line in lines)


def test_a_consumer_that_hangs_gets_a_typed_error_and_can_resume_without_losing_an_a_line():
    where, never = points(200), fabry_perot.RecoveryPolicy(within=0.0)
    with launch(speed=4) as simulator, fabry_perot.connect(simulator.url, recovery=never) as scanner:
        scanner.upload(where, **PARAMETERS)
        scanner.start(scanner.arm())
        lines, lapses = [], 0
        while len(lines) < 200:
            try:
                for batch in scanner.alines():
                    lines += batch
                    scanner.acknowledge(batch[-1])
                    if lapses == 0 and len(lines) > 5:
                        wait_until(lambda: scanner.state == "safe_hold", 60.0)
            except fabry_perot.LeaseExpired:
                lapses += 1
                scanner.resume()
        statistics = scanner.statistics()
    assert lapses >= 1
    assert [line.number for line in lines] == list(range(200))
    assert statistics["shots"] == 200


def wait_until(ready, limit: float) -> None:
    """Bounded wait on a real process."""
    deadline = time.monotonic() + limit
    while not ready():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.long
def test_pause_and_resume_from_another_thread_finish_the_scan():
    import threading

    where = points(600)  # more than the device holds, so that it waits for the host in mid-scan
    with launch(speed=40) as simulator, fabry_perot.connect(simulator.url) as scanner:
        scanner.upload(where, **PARAMETERS)
        scanner.start(scanner.arm())
        states = []

        def operate() -> None:
            scanner.pause()
            states.append(scanner.state)
            scanner.resume()

        lines, operator = [], threading.Thread(target=operate)
        for batch in scanner.alines(idle=True):
            if batch and not lines:
                operator.start()
            lines += batch
            if states:
                scanner.acknowledge(lines[-1])
        operator.join()
    assert states == ["paused"]
    assert [line.number for line in lines] == list(range(600))


def test_an_abort_from_another_thread_ends_the_stream_with_a_typed_error():
    with launch(speed=5) as simulator, fabry_perot.connect(simulator.url) as scanner:
        scanner.upload(points(500), **PARAMETERS)
        scanner.start(scanner.arm())
        with pytest.raises(fabry_perot.ScanAborted):  # noqa: PT012
            for batch in scanner.alines():
                scanner.acknowledge(batch[-1])
                if scanner.state == "scanning":
                    scanner.abort("laser-off")
        assert scanner.state == "safe_hold"


def test_a_port_in_use_is_refused_to_a_second_host():
    with launch() as simulator, fabry_perot.connect(simulator.url), pytest.raises(fabry_perot.PortBusy):
        fabry_perot.connect(simulator.url)


def test_a_report_without_its_shots_is_short_after_any_number_of_them():
    """A list of 200,000 had the simulator, and with it the clock of the scanner, stand still for tenths of a second."""
    with launch(speed=50) as simulator, fabry_perot.connect(simulator.url) as scanner:
        lines = scan(scanner, points(300), pulse_rate=1000.0, samples=64)
        whole, short = simulator.send_command("report"), simulator.send_command("report", fired=False)
    assert len(whole["fired"]) == whole["shots"] == short["shots"] == len(lines)
    assert whole["last_shot"] == short["last_shot"] == whole["fired"][-1][0]
    assert len(json.dumps(short)) < 300


def test_a_port_that_does_not_exist_is_reported_as_such(tmp_path):
    with pytest.raises(fabry_perot.PortUnavailable):
        fabry_perot.connect(str(tmp_path / "nothing"))


def test_a_scanner_that_dies_ends_the_stream_with_a_typed_error():
    with (
        launch(speed=5, tcp="127.0.0.1:0") as simulator,
        fabry_perot.connect(simulator.url, recovery=fabry_perot.RecoveryPolicy(patience=1.0)) as scanner,
    ):
        scanner.upload(points(500), **PARAMETERS)
        scanner.start(scanner.arm())
        with pytest.raises(fabry_perot.LinkLost):  # noqa: PT012
            for batch in scanner.alines():
                scanner.acknowledge(batch[-1])
                if batch[-1].number > 5:
                    os.kill(simulator.pid, signal.SIGKILL)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"samples": 3}, "samples"),
        ({"sampling_interval": 1.0}, "sampling_interval"),
        ({"pulse_rate": 0.0}, "pulse_rate"),
        ({"averages": 0}, "averages"),
    ],
)
def test_a_plan_beyond_the_limits_is_refused_before_anything_moves(change, field, scanner):
    with pytest.raises(fabry_perot.PlanInvalid) as refusal:
        scanner.upload([[0.0, 0.0]], **{**PARAMETERS, **change})
    assert refusal.value.field == field


@pytest.mark.parametrize("where", [[[0.02, 0.0]], [[0.0, float("nan")]], [], [[1.0, 2.0, 3.0]]])
def test_points_off_the_film_or_of_a_wrong_shape_are_refused(where, scanner):
    with pytest.raises(fabry_perot.PlanInvalid, match="points"):
        scanner.upload(np.array(where), **PARAMETERS)


def test_starting_without_a_plan_is_refused(scanner):
    with pytest.raises(fabry_perot.RequestRejected, match="ARM"):
        scanner.arm()


@pytest.fixture(scope="module")
def scanner():
    with launch() as simulator, fabry_perot.connect(simulator.url) as connected:
        yield connected


def test_the_command_links_its_terminal_and_tidies_up_on_sigterm(tmp_path):
    link = tmp_path / "scanner"
    command = [sys.executable, "-m", "fabry_perot.simulator", "--pty", str(link)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE)
    ready = json.loads(process.stdout.readline())
    assert os.readlink(link) == ready["url"]
    assert ready["pid"] == process.pid
    with fabry_perot.connect(str(link)) as scanner:
        assert scanner.state == "linked"
    process.terminate()
    assert process.wait(250) == 0
    process.stdout.close()
    assert not link.is_symlink()


def test_readme_example_runs_unmodified():
    readme = (Path(__file__).parents[2] / "driver" / "README.md").read_text()
    code = re.search(r"```python\n(.*?)```", readme, re.DOTALL).group(1)
    exec(compile(code, "README.md", "exec"), {})  # noqa: S102


def test_simulator_of_exited_parent_removes_its_folder(tmp_path):
    """Whoever leaves at once, or is killed, removes nothing any more."""
    code = """if True:
        import os
        from fabry_perot.simulator import launch
        held = launch()
        held.__enter__()
        print(*os.listdir('.'), flush=True)
        os._exit(1)
    """
    where = {"cwd": tmp_path, "env": os.environ | {"TMPDIR": str(tmp_path)}}
    said = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, timeout=250, **where).stdout
    assert said.startswith("fabry-perot-")
    deadline = time.monotonic() + 60
    while list(tmp_path.iterdir()):
        assert time.monotonic() < deadline
        time.sleep(0.01)
