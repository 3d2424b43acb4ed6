"""The command ``design``: from a time, a vessel and an earlier scan to a mask and a plan that a scanner accepts."""

import json
import re

import numpy as np
import pytest
from typer.testing import CliRunner

import steradian
from steradian.cli.app import app
from steradian.core.exceptions import InvalidInput
from steradian.masks import grid_mask, read_mask
from steradian.phantoms import pressure
from steradian.phantoms.spheres_and_cylinders import gaussian_cylinder
from steradian.plans import ScanPlan, preview
from steradian.plans.files import read_json
from steradian.scans.pulse_noise import read_pulse_noise
from support.commands import run_here

VESSEL = ("--depth", "1.5mm", "--vessel", "150um", "--aperture", "5mm")


def design(*words):
    return CliRunner().invoke(app, ["design", *VESSEL, *map(str, words)], catch_exceptions=False)


def recording(path):
    """Write A-lines of a vessel with noise of 20 dB below their peak; return the file."""
    mask = grid_mask(5e-3, 14, 350e-6, centred=True)
    balls = gaussian_cylinder(150e-6, (0.0, 0.0, 1.5e-3), (0.0, 1.0, 0.0), 2e-3, 15e-6)
    traces = pressure(balls, mask.positions, samples=512, sampling_interval=10e-9, sound_speed=1500.0)
    traces += 0.1 * np.abs(traces).max() * np.random.default_rng(1).standard_normal(traces.shape, dtype=np.float32)
    np.savez(path, traces=traces, positions=mask.positions, dt=10e-9, sound_speed=1500.0, aperture=5e-3)
    return path


@pytest.mark.long
def test_one_command_leads_from_a_scan_to_mask_and_plan(tmp_path):
    earlier = recording(tmp_path / "earlier.npz")
    files = [tmp_path / name for name in ("mask.json", "plan.json", "design.png")]
    words = ("-o", files[0], "--plan", files[1], "--plot", files[2], "--method", "direct", "--arrangement", "grid")
    said = design("--noise-from", earlier, "--time", "1min", "--pulse-rate", "20Hz", "--averages", 2, "--all", *words)
    assert said.exit_code == 0, said.output
    assert float(re.search(r"1,200 pulses, one of (\S+) dB", said.output)[1]) == pytest.approx(20, abs=0.5)
    assert "design.png" in said.output
    plan = read_json(ScanPlan, files[1])
    assert read_mask(files[0]).id == plan.mask.id
    assert (plan.averages, plan.pulse_rate, plan.sampling_interval) == (2, 20.0, 10e-9)
    assert 500 < plan.mask.count <= 600
    cost = preview(plan)
    assert cost.total_seconds <= 60
    assert not cost.has_errors


@pytest.mark.long
def test_noise_of_a_scan_with_averages_is_that_of_one_pulse(tmp_path):
    """The simulated scanner has 30 dB a pulse, of the phantom's highest peak above the film."""
    run_here("mask", "grid", "--aperture", "6mm", "--per-axis", "20", "--interval", "0.3mm", cwd=tmp_path)
    run_here("plan", "mask.json", "--averages", "16", "--pulse-rate", "200Hz", cwd=tmp_path)
    run_here("scan", "run", "plan.json", "--simulator-speed", "200", "--phantom", "vessels", cwd=tmp_path)
    found = read_pulse_noise(tmp_path / "scan.h5").noise
    assert found.decibels == pytest.approx(30, abs=4)
    assert steradian.open(tmp_path / "scan.h5").pulse_noise().decibels == found.decibels


@pytest.mark.long
def test_json_has_the_splits_with_the_proposed_one():
    words = ("--noise", "20", "--pulses", "1000", "--averages", "4", "--arrangement", "grid", "--method", "direct")
    told = json.loads(design(*words, "--json").output)
    (split,) = told["splits"]
    assert split["proposed"]
    assert {name: split[name] for name in told["chosen"]} == told["chosen"]
    assert told["noise_db"] == 20
    assert split["side_lobes_db"] > split["contrast_db"] - 0.5


@pytest.mark.parametrize(
    ("words", "field"),
    [
        (("--time", "1min"), "noise"),
        (("--time", "1min", "--noise", "20", "--noise-from", "scan.h5"), "noise"),
        (("--noise", "20"), "pulses"),
        (("--noise", "20", "--time", "1min", "--pulses", "100"), "pulses"),
    ],
)
def test_one_noise_and_one_duration_are_needed(words, field):
    with pytest.raises(InvalidInput) as refused:
        design(*words)
    assert refused.value.field == field


def test_a_duration_has_hours_minutes_or_seconds():
    from steradian.cli.scan_time import scan_time

    assert [scan_time(text) for text in ("15min", "1.5h", "90s", "90")] == [900, 5400, 90, 90]
    said = design("--noise", "20", "--time", "15 minutes")
    assert said.exit_code == 2
    assert "15min or 90s" in said.output
