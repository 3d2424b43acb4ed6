"""Cost accounting of tests: a plugin of pytest that adds up processor time and sleep, and lists what is over budget.

Processor time is that of the process and all its descendants, without what Numba spends on compiling. Variables of the
environment: with ``STERADIAN_TEST_BUDGET=2`` a run fails when a plain test costs more than twice its budget, and
``STERADIAN_TEST_COSTS=FILE`` writes the costs of all tests as lines of JSON.
"""

import json
import os
import sys
import threading
import time
from collections import defaultdict
from functools import wraps
from operator import gt
from pathlib import Path

import pytest

PROCESSOR_S, SETUP_S, SLEEP_S = 0.5, 2.5, 4.0
"""Budget of a plain test, of its fixtures and of its sleep; what costs more is marked long (CONTRIBUTING.md)."""
TICKS = os.sysconf("SC_CLK_TCK")
SHOWN = 40


def processor_time():
    """Return the processor seconds of this process and its descendants, those that have ended included."""
    parents, seconds = {}, {}
    for name in os.listdir("/proc"):
        if name.isdigit():
            try:
                fields = Path("/proc", name, "stat").read_bytes().rpartition(b")")[2].split()
            except OSError:  # it has ended since
                continue
            parents[int(name)] = int(fields[1])
            seconds[int(name)] = sum(map(int, fields[11:15])) / TICKS
    total, family, grown = 0.0, {os.getpid()}, True
    while grown:
        children = {pid for pid, parent in parents.items() if parent in family} - family
        family |= children
        grown = bool(children)
    for pid in family:
        total += seconds.get(pid, 0.0)
    return total


class CostMeter:
    """Meter of the process that runs tests: processor time, sleep of the main thread, compiling."""

    def __init__(self):
        self.slept = self.compiled = 0.0
        self._sleep, self._depth, self._since = time.sleep, 0, 0.0
        self._listening = False
        time.sleep = self._counted(time.sleep)
        self._last = (processor_time(), 0.0)

    def _counted(self, sleep):
        @wraps(sleep)  # its name, too: it is pickled as the function of the standard library
        def counted(seconds):
            if threading.current_thread() is threading.main_thread():
                self.slept += seconds
            sleep(seconds)

        return counted

    def _listen(self):
        """Count compilation from the moment at which Numba is imported."""
        if not self._listening and "numba" in sys.modules:
            from numba.core import event

            event.Listener.register(CostMeter)
            event.register("numba:compile", self)
            self._listening = True

    def notify(self, event):
        """Take an event of Numba: the outermost start and end of a compilation."""
        if event.is_start:
            if not self._depth:
                self._since = time.thread_time()
            self._depth += 1
        else:
            self._depth -= 1
            if not self._depth:
                self.compiled += time.thread_time() - self._since

    def lap(self):
        """Return the seconds of processor and of sleep since the last call."""
        self._listen()
        now = (processor_time() - self.compiled, self.slept)
        lap = max(0.0, now[0] - self._last[0]), now[1] - self._last[1]
        self._last = now
        return lap

    def close(self):
        """Restore the sleep of the standard library."""
        time.sleep = self._sleep


class Budget:
    """Plugin that measures each phase of each test, and reports in the process that shows the results."""

    def __init__(self, config):
        self.config = config
        self.plain = "not long" in config.option.markexpr
        self.meter = CostMeter() if not config.getoption("numprocesses", None) else None
        self.costs = defaultdict(lambda: {"setup": 0.0, "call": 0.0, "teardown": 0.0, "slept": 0.0})
        self.walks = set()

    def pytest_collection_finish(self):
        """Leave out what the collection cost."""
        if self.meter:
            self.meter.lap()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item, call):
        """Add to a report what its phase cost."""
        report = yield
        report.cost = self.meter.lap()
        report.is_walk = item.get_closest_marker("walk") is not None
        return report

    def pytest_runtest_logreport(self, report):
        """Add up the phases of a test."""
        if hasattr(report, "cost"):
            processor, slept = report.cost
            self.costs[report.nodeid][report.when] += processor
            self.costs[report.nodeid]["slept"] += slept
            if report.is_walk:
                self.walks.add(report.nodeid)

    def over(self, times=1.0):
        """Return the plain tests that cost more than so many times their budget, the most expensive first."""
        limits = {"call": PROCESSOR_S, "setup": SETUP_S, "slept": SLEEP_S}
        costs = [
            (*(cost[part] for part in limits), name) for name, cost in self.costs.items() if name not in self.walks
        ]
        limit = [times * value for value in limits.values()]
        return sorted((row for row in costs if any(map(gt, row, limit))), reverse=True)

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session):
        """Write the costs, and fail where plain tests exceed the stated multiple of their budget."""
        if hasattr(self.config, "workerinput"):
            return
        if self.meter:
            self.meter.close()
        if path := os.environ.get("STERADIAN_TEST_COSTS"):
            lines = (json.dumps({"test": name, **cost}) for name, cost in self.costs.items())
            Path(path).write_text("".join(f"{line}\n" for line in lines))
        times = float(os.environ.get("STERADIAN_TEST_BUDGET", "inf"))
        if self.plain and not session.exitstatus and self.over(times):
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter):
        """List the plain tests over budget, if there are any."""
        if self.plain and (rows := self.over()):
            terminalreporter.section(
                f"plain tests over {PROCESSOR_S} s of processor, {SETUP_S} s for fixtures or {SLEEP_S} s of sleep"
            )
            for call, setup, slept, name in rows[:SHOWN]:
                terminalreporter.write_line(f"{call:5.2f} s, fixtures {setup:5.2f} s, slept {slept:4.1f} s: {name}")
            if len(rows) > SHOWN:
                terminalreporter.write_line(f"and {len(rows) - SHOWN} more")
