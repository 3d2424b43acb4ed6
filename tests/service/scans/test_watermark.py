"""Nothing is acknowledged beyond the first A-line that is not on the disk, whatever fails and whoever leaves."""

import random
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from faulty_disk import BROKEN, FULL, FaultyDisk

import fabry_perot
from fabry_perot.simulator import launch
from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.scans.acquisition.run import resume_scan, run_scan
from steradian.scans.acquisition.session import ScanSession
from steradian.scans.acquisition.session_control import Command, SessionControl, SessionOutcome
from steradian.scans.file.verify import verify_scan_file
from steradian.scans.file.writer import ScanFileWriter, create_scan_file

RUNS = 30


@pytest.fixture(scope="module")
def plan():
    mask = equi_steradian_mask(aperture=13.56e-3, depth=3.6e-3, count=40)
    return ScanPlan.create(mask=mask, samples=256, pulse_rate=100.0)


@pytest.fixture(scope="module")
def simulator():
    with launch(speed=20.0, noise_db=float("inf"), energy_jitter=0.0, ring=8) as simulator:
        yield simulator


@pytest.fixture(scope="module")
def whole(simulator, plan, tmp_path_factory):
    """The samples of a scan that nothing disturbed."""
    return undisturbed(simulator, plan, tmp_path_factory.mktemp("whole") / "scan.h5")


def undisturbed(simulator, plan, path):
    run_scan(plan, simulator.url, path)
    with h5py.File(path, "r") as file:
        return file["alines/samples"][:]


class Witness:
    """Compares every acknowledgement with what was synchronised by then."""

    def __init__(self, scanner, disk, store, whole):
        self.disk, self.whole, self.first = disk, whole, 0
        self.store, self.acknowledge = store, scanner.acknowledge
        with h5py.File(disk.path, "r") as file:
            samples, status = file["alines/samples"], file["alines/status"].id.get_offset()
            step = samples.chunks[0]
            self.samples = [
                samples.id.get_chunk_info_by_coord((row, 0)).byte_offset + row % step * whole[0].nbytes
                for row in range(len(whole))
            ]
            self.status = [status + row for row in range(len(whole))]
        self.rows, self.acknowledged = None, 0
        scanner.acknowledge = self

    def __call__(self, aline):
        rows = self.session._rows[: aline.number + 1]
        for row in rows.tolist():
            start = self.samples[row]
            assert self.disk.durable[self.status[row]] == 1, f"row {row} is acknowledged and not called stored"
            found = self.disk.durable[start : start + self.whole[row].nbytes]
            assert found == self.whole[row].tobytes(), f"row {row} is acknowledged and not on the disk"
        self.acknowledged += 1
        self.acknowledge(aline)


def measure(scanner, store, disk, control, whole):
    """One session under the eyes of a witness; returns how it ended, and the witness."""
    witness = Witness(scanner, disk, store, whole)
    session = witness.session = ScanSession(scanner, store, control)
    session.drain_previous_upload()
    return session.acquire(store.missing), witness


class StopsWhileFull(SessionControl):
    """Wishes an end while the disk is full, upon which there is space again."""

    full = False

    def progress(self, done, total):
        self.full = self.full or 10 <= done

    def command(self):
        return Command.STOP if self.over else Command.RUN

    over = False

    def on_storage_blocked(self, why):
        self.over = True

    def wait(self, seconds):
        time.sleep(0.001)


@pytest.mark.long
def test_an_aline_that_found_no_space_is_not_freed_by_the_next_one(plan, tmp_path, monkeypatch):
    """The disk is full for one write, somebody stops the scan, and what comes after finds space."""
    plan = plan.replace(mask=equi_steradian_mask(aperture=13.56e-3, depth=3.6e-3, count=300))
    with launch(speed=4.0, noise_db=float("inf"), energy_jitter=0.0) as simulator:
        whole = undisturbed(simulator, plan, tmp_path / "whole.h5")
        after = [
            stopped_while_full(simulator, plan, whole, tmp_path / f"{number}.h5", monkeypatch) for number in (1, 2)
        ]
    assert any(after), "A-lines came after the one that found no space"


def stopped_while_full(simulator, plan, whole, path, monkeypatch):
    """Run such a scan; returns how often was acknowledged after the failure but for what had failed."""
    create_scan_file(path, plan, scanner="SIM-0000", simulated=True)
    control = StopsWhileFull()
    faults = iter([FULL])

    def fault():
        if not control.full or (number := next(faults, None)) is None:
            return None
        control.before = witness[0].acknowledged
        shots = simulator.send_command("report")["shots"]
        wait_until(
            lambda: (now := simulator.send_command("report"))["shots"] >= shots + 3 or now["state"] != "scanning"
        )
        return number

    witness = []
    disk = FaultyDisk(path, fault)
    with (
        fabry_perot.connect(simulator.url) as scanner,
        ScanFileWriter(path) as store,
        disk.mounted(monkeypatch),
    ):
        witness.append(Witness(scanner, disk, store, whole))
        session = witness[0].session = ScanSession(scanner, store, control)
        end = session.acquire(store.missing)
        assert (end, store.stored) == (SessionOutcome.STOPPED, scanner.report().fired)
    return witness[0].acknowledged - control.before - 1


def wait_until(condition):
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)


class Moody(SessionControl):
    """Wishes now this, now that, and sometimes dies of it."""

    def __init__(self, chance):
        super().__init__()
        self.chance, self.mood, self.full = chance, Command.RUN, False

    def command(self):
        roll = self.chance.random()
        if self.mood is Command.PAUSE:
            self.mood = Command.RUN if roll < 0.3 else Command.STOP if roll < 0.4 else self.mood
        elif self.mood is Command.RUN and roll < 0.12:
            self.mood = self.chance.choice([Command.PAUSE, Command.PAUSE, Command.STOP, Command.ABORT])
        return self.mood

    def progress(self, done, total):
        self.full = self.full or self.chance.random() < 0.2
        if self.chance.random() < 0.02:
            raise KeyboardInterrupt

    def wait(self, seconds):
        self.full = self.full and self.chance.random() < 0.7
        time.sleep(0.001)

    def fault(self):
        """What the next write meets."""
        if self.full:
            self.full = self.chance.random() < 0.9
            return FULL
        roll = self.chance.random()
        return BROKEN if roll < 0.004 else FULL if roll < 0.02 else "short" if roll < 0.1 else None


@pytest.mark.parametrize(
    "seed", [*range(10), *(pytest.param(seed, marks=pytest.mark.long) for seed in range(10, RUNS))]
)
def test_acknowledgement_under_random_faults_never_passes_unsynced_aline(
    seed, plan, simulator, whole, tmp_path, monkeypatch
):
    """… and the scan is ended by later sessions, bit for bit the one that nothing disturbed."""
    chance, path = random.Random(seed), tmp_path / "a.h5"
    create_scan_file(path, plan, scanner="SIM-0000", simulated=True)
    disk = FaultyDisk(path)
    for _ in range(4):
        control = Moody(chance)
        disk.chance = control.fault
        with fabry_perot.connect(simulator.url) as scanner, disk.mounted(monkeypatch):
            try:
                with ScanFileWriter(path) as store:
                    measure(scanner, store, disk, control, whole)
            except (KeyboardInterrupt, OSError):
                continue
    disk.chance = lambda: None
    path.write_bytes(disk.durable)  # the power fails: all that is left is what was synchronised
    summary = resume_scan(path, simulator.url)
    assert (summary.end, summary.stored) == (SessionOutcome.COMPLETE, plan.mask.count)
    with h5py.File(path, "r") as file:
        np.testing.assert_array_equal(file["alines/samples"][:], whole)
    assert verify_scan_file(path).is_consistent
