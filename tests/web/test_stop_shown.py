"""What the bar says of the laser, beside the shutter's own log, in 500 random sequences of what may happen.

A claim is about the moment that it names: "laser off … seen 0.4 s ago" is a claim about 0.4 s ago. It has to be true
of that moment, and no older than a few seconds.
"""

import random
import re
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import suppress

import pytest
from playwright.sync_api import expect

from fabry_perot.simulator import launch
from support.services import Service
from support.waiting import until

SEQUENCES = 500
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
    if (now !== last || Date.now() - window.seen.at(-1)[0] > 200) window.seen.push([Date.now(), text, age]);
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
    """One page, one service, one scanner, and what may happen to them."""

    def __init__(self, scanner, service, page, gun):
        self.scanner, self.service, self.page, self.gun = scanner, service, page, gun
        self.plan = service.plan(1600, pulse_rate=50)
        self.claims = self.openings = 0

    def own_scan(self):
        with suppress(AssertionError):  # the stop stands, or the scanner is away
            self.service.start_scan(self.plan)

    def other_program(self):
        self.gun.fire()

    def frozen_program(self):
        self.gun.freeze(0.2)

    def unplugged(self):
        self.scanner.command("unplug", seconds=0.4)

    def locked_database(self):
        holder = sqlite3.connect(self.service.folder / "steradian.sqlite", isolation_level=None)
        with suppress(sqlite3.OperationalError):
            holder.execute("BEGIN EXCLUSIVE")
            time.sleep(0.2)
            holder.execute("ROLLBACK")
        holder.close()

    def press(self):
        self.page.locator("#stop").click()

    def release(self):
        with suppress(Exception):  # it may take longer than this patience, and may not stand
            self.service.http.delete(STOP, timeout=3)

    def wait(self):
        time.sleep(0.2)

    DEEDS = (own_scan, other_program, other_program, frozen_program, unplugged, locked_database, press, release, wait)


@pytest.mark.timeout(2400)
def test_bar_never_says_off_of_a_laser_whose_shutter_is_open(tmp_path, open_page):
    offset = time.time() - time.monotonic()
    with launch(speed=1.0) as scanner:
        service = Service(tmp_path, scanner=scanner.url, workers=0).start()
        gun = Gun(scanner.url)
        try:
            page = open_page(service, "/data")
            page.provoked("status of 503")  # the database is locked now and then
            page.provoked("status of 409")
            expect(page.locator("#scanner")).to_contain_text("laser off")
            expect(page.locator("#stop")).to_be_visible()
            page.evaluate(RECORD)
            drill, chance = Drill(scanner, service, page, gun), random.Random(34)
            for sequence in range(SEQUENCES):
                for deed in chance.choices(Drill.DEEDS, k=chance.randint(1, 3)):
                    deed(drill)
                time.sleep(chance.uniform(0, 0.2))
                if sequence % 25 == 24:
                    judge(drill, page, scanner, offset)
            until(lambda: not scanner.command("report", fired=False)["shutter"])
            judge(drill, page, scanner, offset)
            assert drill.claims > SEQUENCES / 2, "hardly anything was claimed"
            assert drill.openings > SEQUENCES / 10, "hardly anything fired"
        finally:
            page.close()
            gun.close()
            service.close()


def judge(drill, page, scanner, offset):
    """Compare what was shown since the last time with the movements of the shutter."""
    shown = page.evaluate("() => window.seen.splice(0, window.seen.length - 1)")
    moves = scanner.command("report", fired=False, moves=True)["moves"]
    opened = [(start[1] + offset, end[1] + offset) for start, end in open_times(moves, time.monotonic())]
    drill.openings = len(opened)
    for moment, text, age in shown:
        if not re.search(r"\b(off|idle)\b", text):
            continue
        drill.claims += 1
        when = moment / 1e3
        old = re.fullmatch(r"seen ([\d.]+) s ago", age)
        assert old, f"{text!r} has the age {age!r}"
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
