"""Recovery between real processes over a real port, with faults commanded at run time."""

from __future__ import annotations

import sys
import time
from contextlib import suppress
from functools import cache, partial

import driver_faults
import numpy as np
import pytest
from driver_world import World

import fabry_perot
from fabry_perot import RecoveryPolicy
from fabry_perot.simulator import launch, phantoms
from fabry_perot.simulator.signal_path import peak_pressure
from fabry_perot.wire.constants import AbortLevel, Operation, Type
from fabry_perot.wire.states import DeviceState
from support.waiting import until

SAMPLES = 1024
PATIENT = RecoveryPolicy(patience=60.0)


def points(count: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(-6e-3, 6e-3, (count, 2)).round(6)


@cache
def strongest() -> float:
    return peak_pressure(phantoms.yarn(0), 1500.0)


def exact(lines, where) -> bool:
    """Whether every A-line is what the simulator's documentation says that shot must have recorded."""
    times = np.arange(SAMPLES) * 8000e-12
    clean = phantoms.pressure(phantoms.yarn(0), np.rint(where * 1e9) * 1e-9, times, 1500.0)
    rms = strongest() * 10 ** (-30.0 / 20)
    for line in lines:
        random = np.random.default_rng([0, line.shot])
        energy = 1 + 0.01 * random.standard_normal()
        total = clean[line.point].astype(float) * energy
        total += rms * random.standard_normal(SAMPLES, dtype=np.float32).astype(float)
        if not np.array_equal(np.clip(np.rint(total / line.scale), -32768, 32767).astype(np.int16), line.samples):
            return False
    return True


def take_all(scanner, count: int, events) -> list:
    """Consume a scan to its end; whatever the laser may not come back from by itself, a person takes up here."""
    lines: list = []
    while len(lines) < count:
        try:
            for batch in scanner.alines():
                lines += batch
                keep = partial(scanner.acknowledge, batch[-1])
                if events and len(lines) >= events[0][0] and events[0][1](keep):
                    events.pop(0)
                keep()
        except (fabry_perot.LeaseExpired, fabry_perot.DeviceRestarted):
            scanner.resume()
    return lines


def suffer(simulator, do: str, seconds: float, noise: dict[str, float], keep) -> bool:
    """Let the line or the device fail; a reboot comes when A-lines are on their way, so that it costs some.

    The device, whether its ring is full by then or not, fires once more when it has been told that A-lines are kept,
    and what it sends of that is lost; where this process was so late that the laser is off, nothing is done.
    """
    if do == "reboot":
        before = simulator.send_command("noise", way="down", lost_frames=1.0)["shots"]
        keep()
        while (seen := simulator.send_command("drift", pm=0))["shots"] == before and seen["state"] != "safe_hold":
            time.sleep(0.01)
        if seen["shots"] == before:
            simulator.send_command("noise", way="down", **noise)
            return False
    simulator.send_command(do, seconds=seconds)
    if do == "reboot":
        simulator.send_command("noise", way="down", **noise)
    return True


def run_scan(tmp_path, count: int, faults, **settings):
    where = points(count)
    link = str(tmp_path / "scanner")
    with (
        launch(link=link, **settings) as simulator,
        fabry_perot.connect(link, recovery=PATIENT) as scanner,
    ):
        scanner.upload(where, samples=SAMPLES, sampling_interval=8e-9, pulse_rate=50.0)
        scanner.start(scanner.arm())
        noise = {name: settings[name] for name in ("bit_errors", "lost_frames") if name in settings}
        events = [(after, partial(suffer, simulator, do, seconds, noise)) for after, do, seconds in faults]
        lines = take_all(scanner, count, events)
        report, truth = scanner.report(), simulator.send_command("report")
    assert not events, "it came too late each time"
    assert [line.number for line in lines] == [line.point for line in lines] == list(range(count))
    assert exact(lines, where)
    assert report.is_balanced
    assert report.fired == truth["shots"]
    fired = [point for _, point in truth["fired"]]
    assert tuple(sorted(point for point in set(fired) if fired.count(point) == 2)) == report.refired
    assert report.stored == count
    assert report.held == 0
    return report


@pytest.mark.long
def test_unplugging_and_plugging_in_again_interrupts_a_scan_but_costs_no_shot(tmp_path):
    report = run_scan(tmp_path, 250, [(50, "unplug", 12.0)], speed=20, ring=64)
    assert (report.reconnects, report.restarts, report.refired) == (1, 0, ())


def test_reboot_refires_and_lists_only_points_with_lost_alines(tmp_path):
    report = run_scan(tmp_path, 250, [(50, "reboot", 2.0)], speed=20, ring=64)
    assert report.restarts == 1
    assert report.fired == 250 + len(report.refired)
    assert report.refired


@pytest.mark.parametrize("late", [0, 60])
def test_start_with_late_response_counts_shots_from_first_point(late):
    """A busy host looks at START's answer when A-lines have come already, after the first one and after a reboot."""
    world = World()
    world.connect()
    world.call_upload()
    token = world.call(Operation.ARM)["token"]
    answer = world.call(Operation.START, token=token, **world.host.lease_fields())
    world.run(late)
    assert (len(world.disk) > 0) is (late > 0)
    world.keeper.start(world.plan, answer["laser_shots"], world.clock.now())
    for kept in (10, 20):
        world.until(lambda kept=kept: len(world.disk) >= kept, 10_000)
        lose_some(world)
    world.finish()
    assert_named(world)


def test_reboot_lists_lost_points_fired_by_previous_host():
    world = World()
    world.begin()
    world.run(40)
    world.kill_host()
    world.run(1_000)
    assert world.device.plan.position > len(world.disk), "the device holds A-lines"
    world.down.filters.append(lost := driver_faults.FramesOfType(Type.ALINE, lambda count: True))
    world.new_host()
    world.go()
    lose_some(world)
    world.down.filters.remove(lost)
    world.finish()
    assert_named(world)


def lose_some(world: World) -> None:
    """Let the device reboot while A-lines do not get through, and have somebody take the scan up."""
    lost = driver_faults.FramesOfType(Type.ALINE, lambda count: True)
    world.down.filters.insert(0, lost)
    world.until(lambda: lost.seen >= 4, 10_000)
    world.reboot(200)
    world.down.filters.remove(lost)
    world.until(lambda: world.keeper.waiting, 10_000)
    world.go()


def assert_named(world: World) -> None:
    fired = [index for _, index, _ in world.instrument.log]
    assert world.keeper.ledger.refired == sorted(index for index in set(fired) if fired.count(index) == 2) != []
    assert len(fired) == 40 + len(world.keeper.ledger.refired)


@pytest.mark.soak
def test_soak_1605_points_over_a_bad_line_with_two_unplugs_and_a_reboot(tmp_path, capsys):
    faults = [(300, "unplug", 12.0), (800, "reboot", 3.0), (1200, "unplug", 15.0)]
    report = run_scan(tmp_path, 1605, faults, speed=15, ring=64, bit_errors=1e-5, lost_frames=0.01)
    with capsys.disabled():
        sys.stdout.write(f"\nfired {report.fired} = stored {report.stored} + re-fired {len(report.refired)}\n")
        sys.stdout.write(f"{report}\n")
    assert report.fired == report.stored + len(report.refired)
    assert (report.reconnects, report.restarts) == (2, 1)
    assert report.refired
    assert report.repaired > 0 < report.bad_frames


def test_reboot_without_recovery_raises_device_restarted():
    with (
        launch(speed=5, ring=64) as simulator,
        fabry_perot.connect(simulator.url, recovery=RecoveryPolicy(restarts=False)) as scanner,
    ):
        scanner.upload(points(500), samples=64, sampling_interval=8e-9, pulse_rate=50.0)
        scanner.start(scanner.arm())
        with pytest.raises(fabry_perot.DeviceRestarted):
            take_all(scanner, 500, [(5, lambda _keep: bool(simulator.send_command("reboot", seconds=0.1)))])


@pytest.mark.timeout(100)
@pytest.mark.parametrize(
    ("do", "seconds", "error"), [("reboot", 0.1, fabry_perot.DeviceRestarted), ("unplug", 1e4, fabry_perot.LinkLost)]
)
def test_connection_loss_during_scan_resume_raises_its_error(do, seconds, error, tmp_path):
    # A busy machine may hold this process up for longer than the laser may rest: that would be told instead.
    brief = RecoveryPolicy(patience=2.0 if error is fabry_perot.LinkLost else 60.0, restarts=False, within=60.0)
    with (
        launch(speed=5, ring=64, link=str(tmp_path / "scanner")) as simulator,
        fabry_perot.connect(simulator.url, recovery=brief) as scanner,
    ):
        scanner.upload(points(200), samples=64, sampling_interval=8e-9, pulse_rate=50.0)
        scanner.start(scanner.arm())
        until(lambda: simulator.send_command("drift", pm=0)["state"] == "safe_hold")  # nobody takes A-lines
        batches = scanner.alines(idle=True)
        until(lambda: not next(batches))  # what was fired, and the first step back
        simulator.send_command(do, seconds=seconds)
        with pytest.raises(error):
            list(batches)


def test_the_account_of_a_scan_that_is_over_outlives_a_restart():
    with launch(speed=20) as simulator, fabry_perot.connect(simulator.url) as scanner:
        scanner.upload(points(20), samples=64, sampling_interval=8e-9, pulse_rate=50.0)
        scanner.start(scanner.arm())
        take_all(scanner, 20, [])
        before = scanner.report()
        simulator.send_command("reboot", seconds=0.1)

        def arm():
            with suppress(fabry_perot.LinkError):  # it has no power yet
                scanner.arm()

        with pytest.raises(fabry_perot.DeviceRestarted):
            until(arm)
        after = scanner.report()
    assert (after.points, after.fired, after.stored, after.held) == (20, 20, 20, 0)
    assert after.is_balanced
    assert before.age == 0 < after.age


def test_a_step_of_recovery_that_goes_unanswered_is_tried_again_later():
    world = World()
    world.begin()
    world.keeper._policy = RecoveryPolicy(patience=1e9, within=10.0)
    world.run(60)
    world.unplug(100)
    world.run(100)
    lost = driver_faults.FramesOfType(Type.REQ, lambda count: count < 6)
    world.up.filters.append(lost)
    world.run(4_000)
    world.until(lambda: len(world.disk) == 40, 10_000)
    assert lost.seen > 6, "RELEASE was given up once and asked for anew"
    assert len(world.instrument.log) == 40


def test_an_interruption_that_outlasts_the_patience_ends_the_scan_with_a_lost_link():
    world = World()
    world.begin()
    world.run(60)
    world.keeper._policy = RecoveryPolicy(patience=2.0)
    world.unplug(1 << 40)
    world.run(2_500)
    assert isinstance(world.host.failure, fabry_perot.LinkLost)
    assert world.device.state is DeviceState.SAFE_HOLD


def test_an_emergency_stop_during_recovery_ends_it_and_fires_nothing_more():
    world = World()
    world.begin()
    world.run(60)
    world.reboot(100)
    world.until(lambda: world.keeper.waiting, 5_000)
    world.keeper.resume(world.plan, world.clock.now())
    world.until(lambda: world.keeper.busy and world.device.plan.length > 0, 5_000)
    fired = len(world.instrument.log)
    world.abort(AbortLevel.EMERGENCY_STOP)
    world.run(3_000)
    assert world.device.state is DeviceState.ESTOP
    assert len(world.instrument.log) == fired
    assert not world.keeper.is_recovering
