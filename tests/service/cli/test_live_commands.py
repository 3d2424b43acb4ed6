"""Following a scan and asking "what if", as a person does it: real processes, real files."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.plans.files import write_json
from steradian.reconstructions.volumes.file import read_volume
from support.commands import run_here

YARN = Path(__file__).parents[2] / "data" / "yarn_kwave_slice.npz"


def start(*arguments, cwd):
    return subprocess.Popen(
        [sys.executable, "-m", "steradian", *map(str, arguments)],
        cwd=cwd,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def run(*arguments, cwd, code=0):
    process = start(*arguments, cwd=cwd)
    output = process.communicate(timeout=250)[0]
    assert process.returncode == code, output
    assert "Traceback" not in output
    return output


@pytest.mark.long
def test_a_running_scan_is_followed_to_its_full_reconstruction(tmp_path):
    plan = ScanPlan.create(mask=equi_steradian_mask(6e-3, 2e-3, 100), samples=512)
    write_json(plan, tmp_path / "plan.json")
    follower = start(
        "reconstruct", "scan.h5", "-o", "live", "--follow", "--interval", "200ms", "--modes", "32", cwd=tmp_path
    )
    try:
        run("scan", "plan.json", "--simulator-speed", "0.15", cwd=tmp_path)
        output = follower.communicate(timeout=250)[0]
    finally:
        follower.kill()
    assert follower.returncode == 0, output
    revision = json.loads((tmp_path / "live" / "revision.json").read_text())
    assert revision["final"] is True
    assert revision["number"] >= 2  # the others while the scan ran, for over thirteen seconds
    run_here("reconstruct", "scan.h5", "-o", "whole", "--modes", "32", cwd=tmp_path)
    live, whole = (read_volume(tmp_path / name / "volume.h5").values for name in ("live", "whole"))
    np.testing.assert_array_equal(live, whole)


@pytest.mark.long
def test_subset_comparison_command_prints_and_writes_quality(tmp_path):
    with np.load(YARN) as archive:
        aperture = 64 * float(archive["dx"])
    write_json(equi_steradian_mask(aperture, 1.5e-3, 400), tmp_path / "mask.json")
    output = run_here("what-if", YARN, "out", "--mask", "mask.json", cwd=tmp_path)
    report = json.loads((tmp_path / "out" / "what-if.json").read_text())
    assert report["quality"]["mip_z_correlation"] > 0.85
    assert f"{report['used']} of 4096" in output
    assert f"{report['quality']['mip_z_correlation']:.3f}, the same along z" in output
    assert "sharpness" not in output
    refused = run_here("what-if", YARN, "out", "--mask", "mask.json", "--points", "exact", cwd=tmp_path, code=2)
    assert "points not measured" in refused


@pytest.mark.parametrize("command", ["reconstruct", "what-if"])
def test_their_help_fits_the_screen(command, tmp_path):
    output = run_here(command, "--help", cwd=tmp_path)
    assert {"reconstruct": "--follow", "what-if": "--mask"}[command] in output
