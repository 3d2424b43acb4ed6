"""``steradian scan``: run, resume, retry and check from the command line."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner
from ulid import ULID

from fabry_perot.simulator import launch
from steradian.cli.app import app
from steradian.core.exceptions import DamagedFile, InvalidInput, NotFound
from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.plans.files import write_json
from steradian.scans.acquisition.resume_checks import ResumeRefused
from steradian.scans.acquisition.run import run_scan
from steradian.scans.acquisition.session_control import Command, SessionControl


@pytest.fixture(scope="module")
def simulator():
    with launch(speed=20.0, ring=8, seed=3) as simulator:
        yield simulator


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    mask = equi_steradian_mask(aperture=13.56e-3, depth=3.6e-3, count=60)
    plan = ScanPlan.create(mask=mask, samples=512, pulse_rate=100.0)
    write_json(plan, tmp_path_factory.mktemp("plan") / "plan.json")
    return plan


@pytest.fixture
def part(plan, simulator, tmp_path):
    """The file of a scan that was stopped."""

    class Stop(SessionControl):
        wanted = Command.RUN

        def progress(self, done, total):
            self.wanted = Command.STOP if done >= 20 else Command.RUN

        def command(self):
            return self.wanted

    run_scan(plan, simulator.url, tmp_path / "part.h5", control=Stop())
    return tmp_path / "part.h5"


def call(*words, raises=None):
    """Run a command in this process; returns what it prints, or the error it ends with."""
    result = CliRunner().invoke(app, [str(word) for word in words])
    if raises is None:
        assert result.exception is None, result.output
        return result.output
    assert isinstance(result.exception, raises), result.exception
    return f"{result.output}{result.exception}"


def test_scan_plan_is_short_for_scan_run_plan(plan, simulator, tmp_path):
    write_json(plan, tmp_path / "plan.json")
    for words in (["scan"], ["scan", "run"]):
        output = tmp_path / f"{len(words)}.h5"
        said = call(*words, tmp_path / "plan.json", "--scanner", simulator.url, "--output", output)
        assert "53 of 53 A-lines" in said
        assert output.is_file()
        with h5py.File(output) as file:
            ULID.from_str(file.attrs["scan_id"][1:].upper())


def test_scan_resume_command_reports_comparison_and_completes_file(part, simulator):
    said = call("scan", "resume", part, "--scanner", simulator.url)
    assert "53 of 53" in said
    assert "correlated" in said
    assert "all listed" not in call("scan", "check", part)


def test_resume_of_another_plan_is_refused(part, plan, simulator, tmp_path):
    write_json(plan.replace(pulse_rate=10.0), tmp_path / "other.json")
    call("scan", "resume", part, "--plan", tmp_path / "other.json", "--scanner", simulator.url, raises=ResumeRefused)


def test_check_finds_and_corrects_the_table_but_never_an_aline(part, simulator):
    with h5py.File(part, "r+") as file:
        rows = file["alines/status"][:].nonzero()[0][:2]
        file["alines/samples"][rows[0], 5] += 1
        file["alines/status"][rows[1]] = 0
        before = file["alines/samples"][:]
    said = call("scan", "check", part, "--no-repair", raises=DamagedFile)
    assert "not corrected" in said
    said = call("scan", "check", part)
    assert f"1: rows {rows[0]}" in said
    assert f"1: rows {rows[1]}" in said
    assert "sound" in call("scan", "check", part)
    with h5py.File(part) as file:
        assert (file["alines/samples"][:] == before).all()
        assert file["alines/status"][:][rows].tolist() == [0, 1]
    assert "53 of 53" in call("scan", "retry", part, "--scanner", simulator.url)


def test_positions_that_were_changed_are_no_scan_any_more(part):
    with h5py.File(part, "r+") as file:
        file["mask/positions"][3] += 1e-6
    call("scan", "check", part, raises=DamagedFile)
    call("scan", "check", part.with_name("none.h5"), raises=NotFound)


@pytest.mark.long
def test_scan_command_with_phantom_simulates_that_phantom(plan, tmp_path):
    """Each phantom gives other A-lines, a file of balls those of its own; the line to go on with names it."""
    write_json(plan, tmp_path / "plan.json")
    ball = {"centres": [[0.0, 0.0, 3e-3]], "sigmas": [50e-6], "amplitudes": [1.0]}
    np.savez(tmp_path / "ball.npz", **{name: np.array(values) for name, values in ball.items()})
    for name in ("yarn", "vessels", tmp_path / "ball.npz"):
        output = tmp_path / f"{Path(name).stem}.h5"
        call("scan", tmp_path / "plan.json", "--phantom", name, "--simulator-speed", "50", "--output", output)
    strongest = {}
    for name in ("yarn", "vessels", "ball"):
        with h5py.File(tmp_path / f"{name}.h5") as file:
            strongest[name] = np.abs(file["alines/samples"][:].astype(float)).argmax(axis=1) * 8e-9 * 1500.0
            positions = file["mask/positions"][:]
    distance = np.sqrt((positions**2).sum(axis=1) + 3e-3**2)
    reached = distance < 512 * 8e-9 * 1500.0 - 200e-6
    assert np.abs(strongest["ball"] - distance)[reached].max() < 150e-6
    assert np.abs(strongest["yarn"] - strongest["vessels"]).max() > 150e-6


@pytest.mark.parametrize("phantom", ["nonsense", "plan.json"])
def test_a_phantom_that_is_none_is_refused_by_name(plan, tmp_path, phantom):
    write_json(plan, tmp_path / "plan.json")
    words = ("scan", tmp_path / "plan.json", "--phantom", tmp_path / phantom, "--output", tmp_path / "scan.h5")
    error = call(*words, raises=InvalidInput)
    assert phantom in error
    assert "vessels" in error
    assert not (tmp_path / "scan.h5").exists()
