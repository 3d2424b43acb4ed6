"""kill -9 at every edge of a scan's stages: each A-line is measured once, and each stage is made once."""

import os
import signal
import sys
from pathlib import Path

import h5py
import httpx
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1] / "scans"))
from staged_bench import PLACES as FOUND
from staged_bench import KnownPlanner, staged_plan
from staged_main import PLACES, WHILE_MEASURING

from fabry_perot.simulator import launch
from steradian.scans.acquisition.run import run_scan
from steradian.scans.file.stages import read_stages
from steradian.scans.file.verify import verify_scan_file
from support import warmed

pytestmark = [pytest.mark.crash, pytest.mark.timeout(180)]
MAIN = Path(__file__).with_name("staged_main.py")
REFERENCE_SHOTS = 16
"""Shots that prove at a resumption that the scan is the same."""


@pytest.fixture(scope="module")
def simulator():
    with launch(speed=50.0) as simulator:
        yield simulator


@pytest.fixture(scope="module")
def undisturbed(simulator, tmp_path_factory):
    path = tmp_path_factory.mktemp("undisturbed") / "scan.h5"
    run_scan(staged_plan(pulse_rate=200.0), simulator.url, path, planner=KnownPlanner())
    return path


def call(simulator, path, how, where=""):
    return warmed.run([sys.executable, str(MAIN), simulator.url, str(path), how, where], env=dict(os.environ))


def table(path):
    with h5py.File(path) as file:
        return {name: column[:] for name, column in file["alines"].items()}


@pytest.mark.parametrize("where", PLACES)
def test_killed_scan_measures_each_aline_once_and_makes_each_stage_once(simulator, undisturbed, tmp_path, where):
    path = tmp_path / "scan.h5"
    killed = call(simulator, path, "run", where)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    assert verify_scan_file(path, repair=False).damaged.size == 0, "a whole file at every moment"
    before, stages = table(path), read_stages(path)
    resumed = call(simulator, path, "resume")
    assert resumed.returncode == 0, resumed.stderr
    after, kept = table(path), before["status"] == 1
    assert (after["status"] == 1).all()
    for name, column in before.items():
        np.testing.assert_array_equal(after[name][: len(kept)][kept], column[kept], err_msg=name)
    with h5py.File(path) as file, h5py.File(undisturbed) as other:
        assert file["plan"].attrs["id"] == other["plan"].attrs["id"], "the same stages"
        np.testing.assert_array_equal(file["mask/positions"], other["mask/positions"])
        fired = int(file["fired"][()])
    proof = fired - len(after["status"])
    assert proof in ({0, REFERENCE_SHOTS} if where in WHILE_MEASURING else {REFERENCE_SHOTS}), "no shot was fired twice"
    first, second = read_stages(path)
    assert (first.points, second.points_of_interest) == (24, FOUND[:1])
    assert stages in ((), (first, second)), "a stage that was made stays as it is"
    assert not [each for each in tmp_path.iterdir() if each != path], "no draft is left"


@pytest.mark.parametrize("process", ["api", "worker-0", "planner", "acquisition", "supervisor"])
def test_process_killed_while_the_scan_waits_for_a_decision(embedded, process):
    service = embedded
    scan_id = service.start_scan(plan_with_survey(service))["id"]
    service.until(lambda: is_asked(service, scan_id), 60)
    kill(service, process)
    service.until(lambda: service.answers, 60)
    if process in ("acquisition", "supervisor"):
        service.until(lambda: read(service, scan_id)["state"] == "interrupted", 60)
        assert read(service, scan_id)["stages"][1]["state"] == "proposed"
        put(service, f"/scans/{scan_id}/desired-state", {"state": "running"})
        service.until(lambda: is_asked(service, scan_id), 60)
    decided = put(service, f"/scans/{scan_id}/stages/2", {"points_of_interest": [FOUND[0]]})
    assert decided["stages"][1]["state"] == "decided"
    service.until(lambda: read(service, scan_id)["state"] == "complete", 60)
    scan = read(service, scan_id)
    assert scan["summary"]["stored"] == scan["summary"]["points"] == sum(stage["points"] for stage in scan["stages"])
    assert [stage["state"] for stage in scan["stages"]] == ["made", "made"]


def kill(service, process):
    if process == "supervisor":
        service.process.kill()
        service.process.wait()
        service.start()
    else:
        service.kill(planner_of(service) if process == "planner" else service.pid_of(process))


def plan_with_survey(service):
    """A plan over HTTP whose survey shows nothing, so that a person must choose."""
    base = f"{service.url}/api/v1"
    mask = httpx.post(
        f"{base}/masks",
        json={"arrangement": "equi-steradian", "aperture": 0.01356, "depth": 0.0036, "count": 60},
        timeout=90,
    ).json()
    survey = {"points": 24, "decision": "ask", "least_signal_to_noise": 1000.0}
    wanted = {"mask_id": mask["id"], "samples": 384, "pulse_rate": 200.0, "survey": survey}
    return httpx.post(f"{base}/plans", json=wanted, timeout=90).raise_for_status().json()["id"]


def planner_of(service):
    """The process that computes stages, a child of the acquisition process."""
    children = Path(f"/proc/{service.pid_of('acquisition')}/task/{service.pid_of('acquisition')}/children")
    found = [int(pid) for pid in children.read_text().split()]
    planners = [pid for pid in found if b"steradian.core.child_process" in Path(f"/proc/{pid}/cmdline").read_bytes()]
    assert len(planners) == 1
    return planners[0]


def read(service, scan_id):
    try:
        answer = httpx.get(f"{service.url}/api/v1/scans/{scan_id}", timeout=90)
        return answer.raise_for_status().json()
    except httpx.HTTPError:
        return {"state": "", "stages": None}


def is_asked(service, scan_id):
    scan = read(service, scan_id)
    return scan["state"] == "paused" and scan["stages"][1]["state"] == "proposed"


def put(service, path, wanted):
    return httpx.put(f"{service.url}/api/v1{path}", json=wanted, timeout=90).raise_for_status().json()
