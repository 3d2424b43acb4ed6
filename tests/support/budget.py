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


class ProcessorTime:
    """Processor seconds of this process and its descendants, those that have ended included.

    Each test asks three times, so that only descendants are read: nobody else's process becomes one later.
    """

    def __init__(self):
        self._others, self._family, self._newest = {}, set(), None

    def read(self):
        """Return the seconds."""
        own = os.times()
        total = own.user + own.system + own.children_user + own.children_system
        try:
            os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
        except ChildProcessError:  # there are none
            return total
        if (newest := _newest_process()) != self._newest or newest is None:
            self._find_family()
            self._newest = newest
        return total + sum(_seconds(fields) for fields in map(_stat, self._family) if fields)

    def _find_family(self):
        """Find the descendants; an ended process's number may since be that of another one, with another inode."""
        parents, others, own = {}, {}, str(os.getpid())
        with os.scandir("/proc") as entries:
            for entry in entries:
                name = entry.name
                if not name.isdigit():
                    continue
                if self._others.get(name) == entry.inode():
                    others[name] = entry.inode()
                elif fields := _stat(name):
                    parents[name] = fields[1].decode(), entry.inode()
        family, grown = {own}, True
        while grown:
            children = {name for name, (parent, _) in parents.items() if parent in family} - family
            family |= children
            grown = bool(children)
        self._others = others | {name: inode for name, (_, inode) in parents.items() if name not in family}
        self._family = family - {own}


def _newest_process():
    """Return the number of the process that was started last, on this machine."""
    try:
        return Path("/proc/loadavg").read_bytes().split()[-1]
    except OSError:
        return None


def _stat(name):
    try:
        file = os.open(f"/proc/{name}/stat", os.O_RDONLY)
    except OSError:  # it has ended since
        return None
    try:
        return os.read(file, 4096).rpartition(b")")[2].split()
    except OSError:
        return None
    finally:
        os.close(file)


def _seconds(fields):
    return sum(map(int, fields[11:15])) / TICKS


class CostMeter:
    """Meter of the process that runs tests: processor time, sleep of the main thread, compiling."""

    def __init__(self):
        self.slept = self.compiled = 0.0
        self._sleep, self._depth, self._since = time.sleep, 0, 0.0
        self._listening = False
        time.sleep = self._counted(time.sleep)
        self._processor = ProcessorTime()
        self._last = (self._processor.read(), 0.0)

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
        now = (self._processor.read() - self.compiled, self.slept)
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
