"""What the soak test runs scans on: a data directory with its processes, and what every shot must have measured."""

import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from contextlib import ExitStack
from pathlib import Path

import google_crc32c
import httpx
import numpy as np

from fabry_perot.errors import PortUnavailable
from fabry_perot.hardware import PlanSampling
from fabry_perot.host import WirePlan
from fabry_perot.simulator import launch
from fabry_perot.simulator.instrument import SimulatedInstrument
from fabry_perot.simulator.phantoms import yarn
from steradian.core.exceptions import Conflict
from steradian.core.settings import Settings
from steradian.scans.file.verify import verify_scan_file
from steradian.scans.file.writer import ScanFileWriter
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database
from steradian.storage.repositories.masks import MaskRepository
from steradian.storage.repositories.plans import PlanRepository
from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import DesiredScanState

W = DesiredScanState
SPEED, PHANTOM = 4.0, 11


class Rig:
    """A data directory with its processes; what dies is started again, as the supervisor does."""

    def __init__(self, folder, seed, *, api):
        self.chance, self.folder = random.Random(seed), folder
        self.settings = Settings.create(data=folder, scanner=str(folder / "scanner"))
        self.data = DataDirectory(folder)
        self.data.create()
        self.database = Database(self.data.metadata_url)
        self.database.migrate()
        self.scans, self.plans = ScanRepository(self.database), PlanRepository(self.database)
        self.log, self.counts = (folder / "log").open("ab"), Counter()
        self.simulator = self.simulators = None
        self.listener = socket.create_server(("127.0.0.1", 0)) if api else None
        self.acquisition = self.api = None
        self.start_simulator()
        self.look_after()

    def start_simulator(self):
        self.simulators = ExitStack()
        link = str(self.folder / "scanner")
        settings = {"speed": SPEED, "seed": PHANTOM, "link": link, "ring": 64}
        self.simulator = self.simulators.enter_context(launch(**settings))

    def look_after(self):
        if self.acquisition is None or self.acquisition.poll() is not None:
            self.counts["acquisition started"] += 1
            self.forget(self.acquisition)
            command = [sys.executable, str(Path(__file__).with_name("soak_main.py"))]
            self.acquisition = self.start(command)
        if self.listener is not None and (self.api is None or self.api.poll() is not None):
            self.counts["API started"] += 1
            self.forget(self.api)
            descriptor = self.listener.fileno()
            self.api = self.start([sys.executable, "-m", "steradian.api", str(descriptor)], pass_fds=[descriptor])
            self.api.stdin.write(b"\n")  # the database is migrated
            self.api.stdin.flush()

    @staticmethod
    def forget(process):
        if process is not None:
            process.stdin.close()

    def start(self, command, **more):
        environment, log = self.settings.environment(), self.log
        return subprocess.Popen(command, env=environment, stdin=subprocess.PIPE, stdout=log, stderr=log, **more)

    def queue(self, plan):
        MaskRepository(self.database).put(plan.mask)
        return self.scans.queue(self.plans.put(plan)[0], simulated=True).id

    def wish(self, identifier, state):
        """Ask through the API where there is one; it may be down, and the scan may be over."""
        if self.listener is None:
            try:
                self.scans.set_desired_state(identifier, state, "soak", "soak")
            except Conflict:
                return
        else:
            url = "http://{}:{}/api/v1".format(*self.listener.getsockname())
            try:
                answer = httpx.put(f"{url}/scans/{identifier}/desired-state", json={"state": state}, timeout=5)
                assert answer.status_code in (200, 409), answer.text
            except httpx.TransportError:
                self.counts["requests lost"] += 1

    @staticmethod
    def until(ready, limit=60.0):
        """Wait for something to come true."""
        deadline = time.monotonic() + limit
        while not ready():
            assert time.monotonic() < deadline
            time.sleep(0.02)

    def state(self, identifier):
        return self.scans.get(identifier).state

    def rest(self, low, high):
        time.sleep(self.chance.uniform(low, high))

    def suffer(self, fault, identifier):
        self.counts[fault] += 1
        try:
            getattr(self, "_" + fault.replace("-", "_"))(identifier)
        except (PortUnavailable, BrokenPipeError):
            self.counts["simulator did not listen"] += 1

    def _kill_acquisition(self, identifier):
        self.acquisition.kill()
        self.acquisition.wait()
        before, deadline = len(self.scans.get(identifier).history), time.monotonic() + 30
        while len(self.scans.get(identifier).history) == before and time.monotonic() < deadline:
            self.look_after()
            time.sleep(0.03)

    def _kill_api(self, identifier):
        if self.api is not None:
            self.api.kill()
            self.api.wait()

    def _kill_simulator(self, identifier):
        os.kill(self.simulator.pid, signal.SIGKILL)
        self.rest(0.1, 1.0)
        self.simulators.close()
        self.start_simulator()

    def _stop_acquisition(self, identifier):
        self._stop(self.acquisition.pid)

    def _stop_simulator(self, identifier):
        self._stop(self.simulator.pid)

    def _stop(self, pid):
        os.kill(pid, signal.SIGSTOP)
        self.rest(0.1, 2.0)
        os.kill(pid, signal.SIGCONT)

    def _full_disk(self, identifier):
        (self.folder / "full").touch()
        self.rest(0.3, 1.2)
        self.counts["seen blocked"] += (self.scans.get(identifier).stage or "").startswith("blocked")
        (self.folder / "full").unlink()

    def _copy(self, identifier):
        """The power fails: what was acknowledged before is in the copy, whatever was being written."""
        path = self.data.scan_file(identifier)
        known = self.diary(identifier)
        if path.exists():
            copy = self.folder / "copy.h5"
            shutil.copyfile(path, copy)
            verify_scan_file(copy)
            self.check_diary(copy, known)

    def _noise(self, identifier):
        for way in ("up", "down"):
            self.simulator.send_command("noise", way=way, bit_errors=2e-6, lost_frames=0.01)
        self.rest(0.2, 1.0)
        for way in ("up", "down"):
            self.simulator.send_command("noise", way=way)

    def _stall(self, identifier):
        self.simulator.send_command("stall", way=self.chance.choice(("up", "down")), seconds=SPEED * 0.8)

    def _cut(self, identifier):
        self.simulator.send_command("cut", way=self.chance.choice(("up", "down")), seconds=SPEED * 0.8)

    def _unplug(self, identifier):
        self.simulator.send_command("unplug", seconds=SPEED * 0.6)

    def _reboot(self, identifier):
        self.simulator.send_command("reboot", seconds=SPEED * 0.3)

    def _pause(self, identifier):
        self.wish(identifier, W.PAUSED)
        self.rest(0.1, 1.0)
        self.wish(identifier, W.RUNNING)

    def diary(self, identifier):
        """Rows and checksums that were acknowledged."""
        path = self.folder / "diary"
        lines = path.read_text().splitlines() if path.exists() else []
        entries = [line.split() for line in lines]
        return [(int(row), int(crc)) for name, row, crc in entries if name == f"{identifier}.h5"]

    def check_diary(self, path, entries):
        report = verify_scan_file(path, repair=False)
        assert not len(report.damaged)
        with ScanFileWriter(path) as store:
            rows = np.array([row for row, _ in entries], np.int64)
            assert not store.missing[rows].any(), "every acknowledged A-line is readable"
            found = [google_crc32c.value(store.read_row(row).tobytes()) for row in rows.tolist()]
            assert found == [crc for _, crc in entries]
        return report

    def close(self):
        self.simulators.close()
        for process in (self.acquisition, self.api):
            if process is not None:
                process.stdin.close()
                process.terminate()
                process.wait(20)
        self.database.close()
        self.log.close()
        if self.listener is not None:
            self.listener.close()


class Truth:
    """What every shot at every point measures, computed without the scanner."""

    def __init__(self, plan):
        self.instrument = SimulatedInstrument(yarn(PHANTOM), seed=PHANTOM, clock_rate=SPEED)
        points = WirePlan.from_metres(
            plan.mask.film_positions,
            samples=plan.samples,
            sampling_interval=plan.sampling_interval,
            pulse_rate=plan.pulse_rate,
            averages=plan.averages,
        ).points
        self.instrument.begin(PlanSampling(plan.samples, round(plan.sampling_interval * 1e12), 100_000))
        self.points = points

    def samples(self, point, shot):
        return self.instrument.measure(self.points[point], shot).samples
