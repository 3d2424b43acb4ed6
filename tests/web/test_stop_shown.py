"""What the bar says of the laser, beside the shutter's own log, in random sequences of what may happen.

The page is below a path of nginx, with TLS. The laser fires under the service's own scan, another service's, `steradian
scan run` and another program; lines are unplugged, programs frozen, the database locked, sessions ended, stops pressed.

A claim is about the moment that it names: "laser off … seen 0.4 s ago" is a claim about 0.4 s ago. It has to be true
of that moment, and no older than a few seconds.
"""

import os
import random
import re
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import ExitStack, suppress

import pytest
from playwright.sync_api import expect

from fabry_perot.simulator import launch
from support import warmed
from support.commands import run_here
from support.nginx import Laboratory, needed
from support.services import Service
from support.waiting import until

KEY = "a key for these tests alone"
EACH = 25
"""Sequences after which what was shown is judged; the last three of those have no session."""
STOP = "/scanners/scanner-0/emergency-stop"
BLUR = 0.5
"""Seconds by which the moment of a claim is not known: ages have one decimal and are drawn four times a second."""
OLDEST = 4.0
"""Seconds after which a claim must have become "unknown"."""

GUN = """
import sys
import numpy as np
import fabry_perot
points = np.random.default_rng(2).uniform(-1e-3, 1e-3, (6000, 2))
print("ready", flush=True)
for line in sys.stdin:
    try:
        with fabry_perot.connect(sys.argv[1], recovery=None) as scanner:
            scanner.upload(points, samples=64, sampling_interval=8e-9, pulse_rate=200, tag=int(line))
            scanner.start(scanner.arm())
            print("fires", flush=True)
            for batch in scanner.alines():
                scanner.acknowledge(batch[-1])
                if len(sys.argv) > 2 and batch[-1].number > 600:
                    break
    except (fabry_perot.ScannerError, OSError) as error:
        print("error", error, flush=True)
    print("over", flush=True)
"""
"""Another program that fires for some seconds each time it is told a number."""

RECORD = """() => {
  window.seen = [];
  let last = null;
  const look = () => {
    const pill = document.querySelector("#scanner").cloneNode(true);
    const age = pill.querySelector(".age")?.textContent ?? "";
    pill.querySelector(".age")?.remove();
    const panel = document.querySelector("#stopped");
    const text = pill.innerText + " | " + (panel.hidden ? "" : panel.querySelector("strong")?.innerText ?? "");
    const now = JSON.stringify([text, age]);
    if (now !== last || Date.now() - (window.seen.at(-1)?.[0] ?? 0) > 200) window.seen.push([Date.now(), text, age]);
    last = now;
  };
  new MutationObserver(look).observe(document.body, { subtree: true, childList: true, characterData: true });
  setInterval(look, 50);
}"""


class Gun:
    """Another program on the scanner's port, which is told when to fire."""

    def __init__(self, url):
        command = [sys.executable, "-c", GUN, url, "ends"]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout.readline() == "ready\n"
        self._shots = 0

    def fire(self):
        self._shots += 1
        self.process.stdin.write(f"{self._shots}\n")
        self.process.stdin.flush()

    def freeze(self, seconds):
        self.process.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        self.process.send_signal(signal.SIGCONT)

    def close(self):
        self.process.kill()
        self.process.communicate()


class Drill:
    """One page below a proxy's path, two services, one scanner, and what may happen to them."""

    def __init__(self, scanner, service, other, gun, page, folder):
        self.scanner, self.service, self.other, self.gun = scanner, service, other, gun
        self.page, self.folder = page, folder
        self.plan, self.others_plan = service.plan(1600, pulse_rate=50), other.plan(1600, pulse_rate=50)
        self.command = None
        self.claims = self.openings = 0

    def own_scan(self):
        with suppress(AssertionError):  # the stop stands, or the scanner is away
            self.service.start_scan(self.plan)

    def another_service(self):
        with suppress(AssertionError):
            self.other.start_scan(self.others_plan)

    def other_program(self):
        self.gun.fire()

    def scan_run(self):
        """``steradian scan run``, one at a time."""
        if self.command is None or self.command.poll() is not None:
            (self.folder / "z.h5").unlink(missing_ok=True)
            run = ["-m", "steradian", "scan", "run", "p.json", "--scanner", self.scanner.url, "-o", "z.h5"]
            quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
            self.command = warmed.start([sys.executable, *run], env=dict(os.environ), cwd=self.folder, **quiet)

    def frozen_program(self):
        self.gun.freeze(0.2)

    def unplugged(self):
        self.scanner.send_command("unplug", seconds=0.4)

    def locked_database(self):
        holder = sqlite3.connect(self.service.folder / "steradian.sqlite", isolation_level=None)
        with suppress(sqlite3.OperationalError):
            holder.execute("BEGIN EXCLUSIVE")
            time.sleep(0.2)
            holder.execute("ROLLBACK")
        holder.close()

    def press(self):
        self.page.keyboard.press("Control+.")

    def release(self):
        for each in (self.service, self.other):
            with suppress(Exception):  # it may take longer than this patience, and may not stand
                each.http.delete(STOP, timeout=3)

    def end_session(self):
        """The browser's cookie is gone; the page goes on with its stop ticket alone."""
        self.page.context.clear_cookies()

    def wait(self):
        time.sleep(0.2)

    def end(self):
        if self.command is not None:
            self.command.kill()
            self.command.wait()

    DEEDS = (
        *(own_scan, another_service, other_program, scan_run),
        *(frozen_program, unplugged, locked_database, press, press, release, release, wait),
    )


@pytest.fixture
def drill(tmp_path, chromium):
    """The page is signed in below a path of nginx, with TLS."""
    needed()
    context = chromium.new_context(ignore_https_errors=True, viewport={"width": 1280, "height": 720})
    context.set_default_timeout(200_000)
    keyed = {"api_key": KEY, "require_key": True, "workers": 0}
    with launch(speed=1.0) as scanner, ExitStack() as stack:
        services = []
        for name in ("own", "other"):
            service = Service(tmp_path / name, log=tmp_path / f"{name}.log", scanner=scanner.url, **keyed).start()
            stack.callback(service.close)
            service.http.headers["Authorization"] = f"Bearer {KEY}"
            services.append(service)
        laboratory = Laboratory(tmp_path / "nginx", services[0].url)
        stack.callback(laboratory.close)
        gun = Gun(scanner.url)
        stack.callback(gun.close)
        mask = ["mask", "equi-steradian", "--aperture", "5mm", "--depth", "3.6mm", "--count", "300", "-o", "m.json"]
        run_here(*mask, cwd=tmp_path)
        run_here("plan", "m.json", "-o", "p.json", cwd=tmp_path)
        stack.callback(context.close)
        page = context.new_page()
        page.goto(f"{laboratory.url}/data")
        drill = Drill(scanner, *services, gun, page, tmp_path)
        stack.callback(drill.end)
        yield drill


def sign_in(page):
    """Open the page anew, with a session of its own."""
    page.reload()
    page.get_by_label("API key").fill(KEY)
    page.get_by_role("button", name="Sign in").last.click()
    expect(page.get_by_role("dialog")).to_have_count(0)
    expect(page.locator("#stop")).to_be_visible()
    page.evaluate(RECORD)


@pytest.mark.timeout(2400)
@pytest.mark.parametrize("sequences", [75, pytest.param(500, marks=pytest.mark.nightly)])
def test_status_bar_never_shows_off_while_shutter_is_open(drill, sequences):
    page, chance = drill.page, random.Random(34)
    sign_in(page)
    expect(page.locator("#scanner")).to_contain_text("laser off")
    for sequence in range(sequences):
        for deed in chance.choices(Drill.DEEDS, k=chance.randint(1, 3)):
            deed(drill)
        time.sleep(chance.uniform(0, 0.2))
        if sequence % EACH == EACH - 4:
            drill.end_session()
        if sequence % EACH == EACH - 1:
            judge(drill)
            sign_in(page)
    until(lambda: not drill.scanner.send_command("report", fired=False)["shutter"])
    judge(drill)
    assert drill.claims > sequences / 4, "hardly anything was claimed"
    assert drill.openings > sequences / 10, "hardly anything fired"


def judge(drill):
    """Compare what was shown since the last time with the movements of the shutter."""
    shown, offset = drill.page.evaluate("() => window.seen.splice(0)"), time.time() - time.monotonic()
    moves = drill.scanner.send_command("report", fired=False, moves=True)["moves"]
    opened = [(start[1] + offset, end[1] + offset) for start, end in open_times(moves, time.monotonic())]
    drill.openings = len(opened)
    for moment, text, age in shown:
        if not re.search(r"\b(off|idle)\b", text):
            continue
        drill.claims += 1
        when = moment / 1e3
        old = re.fullmatch(r"updated ([\d.]+) s ago", age)
        if old is None:  # a press that was answered before the page had looked: its answer counts for 3 s
            assert "confirmed by the device" in text, f"{text!r} has the age {age!r}"
            assert not any(start < when - OLDEST and when < end for start, end in opened), text
            continue
        old = float(old[1])
        assert old <= OLDEST, (text, age)
        for start, end in opened:
            assert not (start + BLUR < when - old < end - BLUR), (
                f"{text!r} ({age}) was shown at {when:.2f}, and the shutter was open from {start:.2f} to {end:.2f}"
            )


def open_times(moves, now):
    """Pairs of movements between which the shutter was open."""
    pairs, start = [], None
    for move in moves:
        if move[2]:
            start = move
        elif start is not None:
            pairs.append((start, move))
            start = None
    return pairs + ([(start, (0, now, False))] if start is not None else [])
