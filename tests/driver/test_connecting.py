"""Finding scanners, the asyncio driver, and the small things of ports."""

from __future__ import annotations

import asyncio
import logging

import numpy as np
import pytest

import fabry_perot
from fabry_perot import connecting, framing
from fabry_perot.host import HostTiming
from fabry_perot.simulator import launch

PATIENT = HostTiming(ttl=1_000_000)  # this process may be held up by others
PARAMETERS = {"samples": 64, "sampling_interval": 8e-9, "pulse_rate": 100.0}


def where(count: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(-6e-3, 6e-3, (count, 2)).round(6)


@pytest.fixture(scope="module")
def simulator():
    with launch(speed=20, tcp="127.0.0.1:0") as running:
        yield running


def test_probing_finds_the_scanner_says_what_it_is_and_leaves_out_what_does_not_answer(simulator, tmp_path):
    found = fabry_perot.discover([simulator.url, str(tmp_path / "nothing")], probe=True)
    assert [(item.url, item.serial, item.busy) for item in found] == [(simulator.url, "SIM-0000", False)]


def test_a_port_that_another_process_holds_is_reported_as_busy():
    with launch() as other, fabry_perot.connect(other.url):
        (found,) = fabry_perot.discover([other.url], probe=True)
    assert found.busy


def test_without_probing_nothing_is_sent_to_anybody(monkeypatch, tmp_path):
    monkeypatch.setattr(connecting, "connect", lambda *_, **__: pytest.fail("a port was opened"))
    assert fabry_perot.discover([str(tmp_path)])[0].url == str(tmp_path)
    assert isinstance(fabry_perot.discover(), list)


def test_missing_c_code_for_byte_stuffing_is_said_at_the_start(simulator, monkeypatch, caplog):
    monkeypatch.setattr(framing.cobs, "_using_extension", False)
    with caplog.at_level(logging.WARNING), fabry_perot.connect(simulator.url):
        assert "C extension" in caplog.text


def test_the_asyncio_driver_scans_tunes_and_reports_like_the_synchronous_one(simulator):
    async def scan() -> tuple[list, fabry_perot.ScanReport]:
        lines: list = []
        async with await fabry_perot.connect_async(simulator.url, timing=PATIENT) as scanner:
            assert scanner.capabilities.simulated
            assert (await scanner.tune(0.0, 0.0, steps=11)).levels.shape == (11,)
            assert len((await scanner.pretune(where(2), steps=11)).wavelength) == 2
            assert await scanner.set(interrogation_uw=900) == {"interrogation_uw": 900}
            await scanner.park()
            await scanner.upload(where(60), **PARAMETERS)
            token = await scanner.arm()
            await scanner.disarm()
            assert scanner.state == "ready"
            token = await scanner.arm()
            await scanner.start(token)
            async for batch in scanner.alines():
                lines += batch
                await scanner.acknowledge(batch[-1])
                if len(lines) == len(batch):
                    await scanner.pause()
                    assert scanner.state in ("paused", "draining", "done")
                    if scanner.state == "paused":
                        await scanner.resume()
            assert (await scanner.statistics())["shots"] == scanner.status.shots
            report = await scanner.report()
            await scanner.abort("emergency-stop")
            await scanner.clear_fault()
            return lines, report

    lines, report = asyncio.run(scan())
    assert [line.number for line in lines] == list(range(60))
    assert report.balanced
    assert report.stored == 60


def test_a_plan_with_a_start_measures_only_the_rest_and_keeps_the_numbers(simulator):
    with fabry_perot.connect(simulator.url, timing=PATIENT) as scanner:
        with pytest.raises(fabry_perot.PlanInvalid, match="no scan"):
            scanner.report()
        with pytest.raises(fabry_perot.PlanInvalid, match="level"):
            scanner.abort("gently")
        scanner.upload(where(30), **PARAMETERS, start=20)
        scanner.start(scanner.arm())
        lines = []
        for batch in scanner.alines():
            lines += batch
            scanner.acknowledge(batch[-1])
        report = scanner.report()
    assert [line.number for line in lines] == list(range(20, 30))
    assert report.fired == report.stored == 10


def test_a_packed_scan_over_a_paced_line_is_the_same_and_faster(tmp_path):
    with (
        launch(speed=50, baud=921_600, noise_db=60.0) as paced,
        fabry_perot.connect(paced.url, timing=PATIENT) as scanner,
    ):
        took, lines = {}, {}
        for encoding in ("int16", "auto"):
            scanner.upload(where(8), samples=1024, sampling_interval=8e-9, pulse_rate=1000.0, encoding=encoding)
            scanner.start(scanner.arm())
            lines[encoding] = []
            for batch in scanner.alines():
                lines[encoding] += batch
                scanner.acknowledge(batch[-1])
            took[encoding] = scanner.statistics()["device_time"] * 1e-6 - lines[encoding][0].fire_time_s
    assert all(line.samples.shape == (1024,) for line in lines["auto"])
    assert took["auto"] < took["int16"]
