"""A consumer that is gone: nobody renews the laser's lease in its name, and nothing it was given is lost."""

from __future__ import annotations

import asyncio
import re
import time
from pathlib import Path

import numpy as np
import pytest
from driver_bench import Bench

import fabry_perot
from fabry_perot.device.transmit_queue import MAX_QUEUED
from fabry_perot.simulator import launch
from fabry_perot.wire.constants import AbortLevel, Type
from fabry_perot.wire.framing import Deframer, Frame, encode_frame
from fabry_perot.wire.messages import Abort, pack
from fabry_perot.wire.states import DeviceState

WHERE = np.column_stack([np.linspace(-2e-3, 2e-3, 60), np.zeros(60)])


def until(ready, limit: float = 20.0) -> None:
    """Bounded wait for something to come true."""
    deadline = time.monotonic() + limit
    while not ready():
        assert time.monotonic() < deadline, "it did not come true"
        time.sleep(0.01)


def test_lease_of_abandoned_iterator_is_not_renewed():
    """A thousand shots at 1 Hz take longer than the lease; each look at the iterator renews it once."""
    with launch() as simulator, fabry_perot.connect(simulator.url) as scanner:
        scanner.upload(WHERE, samples=64, sampling_interval=8e-9, pulse_rate=1.0, averages=1000)
        scanner.start(scanner.arm())
        began = scanner.status.lease_until
        batches = scanner.alines(idle=True)
        until(lambda: not next(batches) and scanner.status.lease_until > began)
        until(lambda: simulator.send_command("report")["state"] == "safe_hold")


def test_abandoned_iterators_alines_come_from_the_next():
    numbers: list[int] = []
    with launch(speed=5) as simulator, fabry_perot.connect(simulator.url) as scanner:
        scanner.upload(WHERE, samples=64, sampling_interval=8e-9, pulse_rate=100.0)
        scanner.start(scanner.arm())
        deadline = time.monotonic() + 60
        while len(numbers) < len(WHERE):
            assert time.monotonic() < deadline, f"came: {numbers}"
            for batch in scanner.alines(idle=True):
                if batch:
                    numbers += [line.number for line in batch]
                    scanner.acknowledge(batch[-1])
                break
    assert numbers == list(range(len(WHERE)))


def test_after_a_lapse_and_a_resume_a_lines_come_again():
    numbers: list[int] = []
    lapses = 0
    recovery = fabry_perot.RecoveryPolicy(within=0.0)
    with launch() as simulator, fabry_perot.connect(simulator.url, recovery=recovery) as scanner:
        scanner.upload(WHERE, samples=64, sampling_interval=8e-9, pulse_rate=100.0)
        scanner.start(scanner.arm())
        until(lambda: scanner.state == "safe_hold")  # nothing consumes, so the lease lapses
        while len(numbers) < len(WHERE):
            assert lapses < 100, f"came: {numbers}"
            try:
                for batch in scanner.alines():
                    numbers += [line.number for line in batch]
                    scanner.acknowledge(batch[-1])
            except fabry_perot.LeaseExpired:
                lapses += 1
                scanner.resume()
    assert numbers == list(range(len(WHERE)))
    assert lapses > 0


@pytest.fixture
def scan():
    """The function of the README for asyncio."""
    readme = (Path(__file__).parents[2] / "driver" / "README.md").read_text(encoding="utf-8")
    code = re.search(r"## Under asyncio.*?```python\n(.*?)```", readme, re.DOTALL).group(1)
    names: dict = {}
    exec(compile(code, "README.md", "exec"), names)  # noqa: S102
    return names["scan"]


def test_readme_recipe_scans_under_asyncio(scan):
    numbers: list[int] = []

    async def store(batch):
        numbers.extend(line.number for line in batch)

    with launch(speed=5) as simulator:
        report = asyncio.run(scan(simulator.url, WHERE, store, samples=64, sampling_interval=8e-9, pulse_rate=100.0))
    assert numbers == list(range(len(WHERE)))
    assert report.is_balanced


def test_readme_recipe_turns_laser_off_when_cancelled(scan):
    async def cancel(simulator):
        stored = asyncio.Event()

        async def store(_):
            stored.set()

        parameters = {"samples": 64, "sampling_interval": 8e-9, "pulse_rate": 20.0}
        task = asyncio.create_task(scan(simulator.url, WHERE, store, **parameters))
        await asyncio.wait_for(stored.wait(), 60)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        report = await asyncio.to_thread(simulator.send_command, "report")
        assert report["state"] not in ("running", "armed", "paused"), report

    with launch() as simulator:
        asyncio.run(cancel(simulator))


def waiting(bench: Bench) -> list[Frame]:
    return Deframer().feed(bench.device.next_frames(1 << 24) + b"\0")


def test_a_fault_on_a_line_that_takes_no_bytes_waits_once():
    bench = Bench()
    bench.connect()
    bench.device.raise_fault(7)
    for _ in range(10_000):
        bench.device.poll(bench.device.next_deadline() + 1_000)
    frames = [frame.type for frame in waiting(bench)]
    assert frames.count(Type.FAULT) == 1
    assert len(frames) <= MAX_QUEUED + 3


def test_aborts_without_end_on_a_line_that_takes_no_bytes_are_obeyed_and_their_answers_bounded():
    bench = Bench()
    bench.connect()
    for number in range(10 * MAX_QUEUED):
        data = encode_frame(Frame(Type.ABORT, 2, 0, 0, 0, pack(Abort(AbortLevel.EMERGENCY_STOP, number))))
        bench.device.receive(data, bench.device_now)
    assert bench.device.state is DeviceState.ESTOP
    answers = [frame for frame in waiting(bench) if frame.type == Type.ABORT_ACK]
    assert 0 < len(answers) <= MAX_QUEUED
    assert answers[0].payload[1:5] == (10 * MAX_QUEUED - 1).to_bytes(4, "little"), "the newest first"
