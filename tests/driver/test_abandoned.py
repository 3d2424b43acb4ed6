"""A consumer that is gone: nobody renews the laser's lease in its name, and nothing it was given is lost."""

from __future__ import annotations

import asyncio
import time

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


async def until(ready, limit: float = 20.0) -> None:
    """Bounded wait for something to come true."""
    deadline = time.monotonic() + limit
    while not ready():
        assert time.monotonic() < deadline, "it did not come true"
        await asyncio.sleep(0.01)


def test_a_cancelled_consumers_lease_is_not_renewed_while_the_next_a_line_takes_minutes():
    async def consume(scanner) -> None:
        async for _ in scanner.alines():
            raise AssertionError("a thousand shots at 1 Hz take longer")

    async def cancel(simulator) -> None:
        async with await fabry_perot.connect_async(simulator.url) as scanner:
            await scanner.upload(WHERE, samples=64, sampling_interval=8e-9, pulse_rate=1.0, averages=1000)
            await scanner.start(await scanner.arm())
            task = asyncio.create_task(consume(scanner))
            began = scanner.status.lease_until
            await until(lambda: scanner.status.lease_until > began)  # it renews
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            await until(lambda: simulator.send_command("report")["state"] == "safe_hold")

    with launch() as simulator:
        asyncio.run(cancel(simulator))


def test_cancelled_consumer_pending_alines_go_to_next_consumer():
    async def take_all(simulator) -> list[int]:
        numbers: list[int] = []
        async with await fabry_perot.connect_async(simulator.url) as scanner:
            await scanner.upload(WHERE, samples=64, sampling_interval=8e-9, pulse_rate=100.0)
            await scanner.start(await scanner.arm())
            wait = 0.001
            deadline = time.monotonic() + 60
            while len(numbers) < len(WHERE):
                assert time.monotonic() < deadline, f"came: {numbers}"
                try:
                    async with asyncio.timeout(wait):
                        async for batch in scanner.alines():
                            numbers += [line.number for line in batch]
                            await scanner.acknowledge(batch[-1])
                except TimeoutError:
                    wait = 0.001 + (7 * wait) % 0.05
                except fabry_perot.LeaseExpired:
                    await scanner.resume()
        return numbers

    with launch(speed=5) as simulator:
        assert asyncio.run(take_all(simulator)) == list(range(len(WHERE)))


def test_after_a_lapse_and_a_resume_a_lines_come_again():
    async def take_all(simulator) -> tuple[list[int], int]:
        numbers: list[int] = []
        lapses = 0
        recovery = fabry_perot.RecoveryPolicy(within=0.0)
        async with await fabry_perot.connect_async(simulator.url, recovery=recovery) as scanner:
            await scanner.upload(WHERE, samples=64, sampling_interval=8e-9, pulse_rate=100.0)
            await scanner.start(await scanner.arm())
            await until(lambda: scanner.state == "safe_hold")  # nobody consumes, so the lease lapses
            while len(numbers) < len(WHERE):
                assert lapses < 100, f"came: {numbers}"
                try:
                    async for batch in scanner.alines():
                        numbers += [line.number for line in batch]
                        await scanner.acknowledge(batch[-1])
                except fabry_perot.LeaseExpired:
                    lapses += 1
                    await scanner.resume()
        return numbers, lapses

    with launch() as simulator:
        numbers, lapses = asyncio.run(take_all(simulator))
    assert numbers == list(range(len(WHERE)))
    assert lapses > 0


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
