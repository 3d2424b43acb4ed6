"""Scans while everything around them fails at random: what was acknowledged is there, nothing is there twice.

``pytest -m soak`` runs twenty scans on real processes (acquisition, API, simulated scanner) that are killed, stopped
and cut off; a short version is among the plain tests. The seed and the counts are printed.
"""

import importlib.util
import itertools
import json
import os
import signal
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.scans.file.writer import ScanFileWriter
from steradian.storage.state_machines import SCAN_TRANSITIONS, DesiredScanState, ScanState, is_terminal

S, W = ScanState, DesiredScanState
SEED = int(os.environ.get("STERADIAN_SOAK_SEED", "1"))
FAULTS = (
    "kill-acquisition kill-acquisition kill-acquisition kill-api kill-simulator stop-acquisition stop-simulator"
    " full-disk copy noise stall cut unplug reboot pause"
).split()


@pytest.fixture(scope="module")
def rigs():
    """The module beside this one."""
    spec = importlib.util.spec_from_file_location("soak_rig", Path(__file__).with_name("soak_rig.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def run_one(rig, plan, truth, faults, end=None):
    """Run one scan through its faults to its end and judge it; returns its last state."""
    identifier = rig.queue(plan)
    chance, faults, deadline = rig.chance, list(faults), time.monotonic() + 90
    due = None
    while not is_terminal(state := rig.state(identifier)):
        assert time.monotonic() < deadline, f"{rig.scans.get(identifier).history}, {rig.folder / 'log'}"
        rig.look_after()
        if state is S.INTERRUPTED and not (end is not None and not faults):
            rig.wish(identifier, W.RUNNING)
        elif state is S.INTERRUPTED:
            rig.wish(identifier, end)
        elif state is S.PAUSED and not faults:
            rig.wish(identifier, W.RUNNING)
        if state is S.RUNNING and due is None:
            due = time.monotonic() + chance.uniform(0.05, 0.5)
        if due is not None and time.monotonic() >= due:
            due = None
            if faults:
                rig.suffer(faults.pop(0), identifier)
            elif end is not None:
                rig.wish(identifier, end)
        time.sleep(0.03)
    judge(rig, identifier, plan, truth, state, end)
    return state


def judge(rig, identifier, plan, truth, state, end):
    row = rig.scans.get(identifier)
    states = [ScanState(entry["state"]) for entry in row.history]
    for before, after in itertools.pairwise(states):
        assert after in SCAN_TRANSITIONS[before], states
    rig.counts["resumed"] += list(itertools.pairwise(states)).count((S.INTERRUPTED, S.ARMING))
    allowed = {None: {S.COMPLETE}, W.STOPPED: {S.PARTIAL, S.COMPLETE}, W.ABORTED: {S.ABORTED, S.PARTIAL, S.COMPLETE}}
    assert state in allowed[end], (state, row.error)
    entries, path = rig.diary(identifier), rig.data.scan_file(identifier)
    # an acknowledgement that was lost on the way is given again, of the very same shot: each has noise of its own
    assert max(Counter(row for row, _ in set(entries)).values()) == 1, "no point was accepted from two shots"
    rig.counts["acknowledged again"] += len(entries) - len(set(entries))
    report = rig.check_diary(path, entries)
    assert report.is_consistent
    assert report.intact == row.summary["stored"]
    assert state is not S.COMPLETE or report.intact == plan.aline_count
    with ScanFileWriter(path) as store:
        shots = store.column("shot")
        for place in np.flatnonzero(~store.missing).tolist():
            expected = truth.samples(place % plan.mask.count, int(shots[place]))
            np.testing.assert_array_equal(store.read_row(place), expected)
        rig.counts["shots"] += store.fired
    rig.counts["A-lines"] += report.intact
    rig.counts["acknowledged"] += len(set(entries))
    rig.counts[f"ended {state}"] += 1


def soak(rigs, folder, seed, scans, capsys, *, api, count, faults=FAULTS, most=4):
    plan = ScanPlan.create(mask=equi_steradian_mask(13.56e-3, 3.6e-3, count), samples=1024, pulse_rate=25.0)
    begin, truth, rig = time.monotonic(), rigs.Truth(plan), rigs.Rig(folder, seed, api=api)
    try:
        pool = rig.chance.sample(faults, len(faults))
        for number in range(scans):
            chosen = [pool[(number * most + k) % len(pool)] for k in range(rig.chance.randint(1, most))]
            end = {5: W.STOPPED, 9: W.ABORTED}.get(number % 10)
            run_one(rig, plan, truth, chosen, end)
    finally:
        rig.close()
        seconds = time.monotonic() - begin
        with capsys.disabled():
            print(f"\n  seed {seed}, {seconds:.0f} s: {json.dumps(dict(sorted(rig.counts.items())))}")
    assert sum(number for name, number in rig.counts.items() if name.startswith("ended")) == scans
    return rig.counts


@pytest.mark.long
def test_stalled_acquisition_process_fires_nothing_until_scan_is_resumed(rigs, tmp_path, capsys):
    plan = ScanPlan.create(mask=equi_steradian_mask(13.56e-3, 3.6e-3, 60), samples=1024, pulse_rate=5.0)
    rig, truth = rigs.Rig(tmp_path, 3, api=False), rigs.Truth(plan)
    try:
        identifier = rig.queue(plan)
        rig.until(lambda: len(rig.diary(identifier)) > 5)
        os.kill(rig.acquisition.pid, signal.SIGSTOP)
        began = rig.simulator.send_command("report")["time"]
        rig.until(lambda: rig.simulator.send_command("report")["time"] > began + 12e6)
        dark = rig.simulator.send_command("report")
        os.kill(rig.acquisition.pid, signal.SIGCONT)
        rig.until(lambda: rig.state(identifier) is S.INTERRUPTED)
        after = rig.simulator.send_command("report")
        assert (dark["state"], dark["shots"]) == ("safe_hold", after["shots"]), "12 s of the scanner's time"
        assert rig.scans.get(identifier).error_code == "scan-interrupted"
        rig.wish(identifier, W.RUNNING)
        rig.until(lambda: is_terminal(rig.state(identifier)))
        judge(rig, identifier, plan, truth, rig.state(identifier), None)
        assert rig.simulator.send_command("report")["shots"] == rig.scans.get(identifier).summary["fired"]
    finally:
        rig.close()


@pytest.mark.soak
@pytest.mark.timeout(1800)
def test_twenty_scans_while_everything_fails(rigs, tmp_path, capsys):
    counts = soak(rigs, tmp_path, SEED, 20, capsys, api=True, count=230)
    assert all(counts[fault] for fault in FAULTS), "each fault happened"
    assert counts["resumed"] > 2, "and scans were taken up again with their proof"


@pytest.mark.timeout(60)
@pytest.mark.long
def test_two_scans_while_much_fails(rigs, tmp_path, capsys):
    plan = ScanPlan.create(mask=equi_steradian_mask(13.56e-3, 3.6e-3, 60), samples=1024, pulse_rate=10.0)
    rig, truth = rigs.Rig(tmp_path, 3, api=False), rigs.Truth(plan)
    try:
        for faults in (["full-disk", "copy", "kill-acquisition"], ["stop-acquisition", "unplug"]):
            assert run_one(rig, plan, truth, faults) is S.COMPLETE
        assert rig.counts["resumed"] >= 1, "more where this machine held somebody up for seconds"
        assert rig.counts["seen blocked"] == 1
    finally:
        rig.close()
        with capsys.disabled():
            print(f"\n  {json.dumps(dict(sorted(rig.counts.items())))}")
