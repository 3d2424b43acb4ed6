"""A partly measured scan: its reconstruction names what is missing."""

import dataclasses
import json
from math import atan, degrees

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

from fabry_perot import ALine
from fabry_perot.simulator.phantoms import Balls, pressure
from steradian.cli.app import app
from steradian.imaging import Acquisition, ImageGrid, Iterative, reconstruct
from steradian.masks import grid_mask
from steradian.plans import ScanPlan
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.completeness import find_missing_points
from steradian.reconstructions.pipeline.run import reconstruct_scan
from steradian.scans.file.create import create_scan_file
from steradian.scans.file.writer import ScanFileWriter
from steradian.scans.opening import open_recording

STEP, SIDE = 0.3e-3, 21
BALL = Balls(np.array([[0.3e-3, -0.2e-3, 1.5e-3]]), np.array([150e-6]), np.array([1.0]))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A scan file of a ball over a grid of 21 × 21 points."""
    path = tmp_path_factory.mktemp("scan") / "whole.h5"
    plan = ScanPlan.create(mask=grid_mask(6.4e-3, SIDE, STEP), samples=200, sampling_interval=16e-9)
    create_scan_file(path, plan, scan_id="s", scanner="", scanner_model="", simulated=True)
    traces = pressure(BALL, plan.mask.film_positions, 16e-9 * np.arange(200), 1500.0)
    scale = float(np.abs(traces).max()) / 30_000
    empty = ALine(0, 0, np.zeros(200, np.int16), scale, 16e-9, 0.0, 1, 1, 1.0, 1.55e-6, 0.0, 0.0, 0.0, 0)
    counts = np.round(traces / scale).astype(np.int16)
    with ScanFileWriter(path) as store:
        lines = [dataclasses.replace(empty, point=point, samples=line) for point, line in enumerate(counts)]
        store.append(lines, np.arange(SIDE**2))
    return path


def without(whole, tmp_path, lost):
    """Return a copy of the file in which the points that are ``lost(x, y)`` have not been measured."""
    path = tmp_path / "part.h5"
    path.write_bytes(whole.read_bytes())
    with h5py.File(path, "r+") as file:
        x, y = file["mask/positions"][:].T
        file["alines/status"][:] = ~lost(x, y)
    return path


def test_missing_points_reports_hole_count_position_and_width(whole, tmp_path):
    """5 × 5 points around (1.2, -0.6) mm: the nearest measured point is three steps from the middle of the hole."""
    path = without(whole, tmp_path, lambda x, y: (abs(x - 1.2e-3) < 0.65e-3) & (abs(y + 0.6e-3) < 0.65e-3))
    found = find_missing_points(open_recording(path))
    assert (found.count, found.planned) == (25, SIDE**2)
    np.testing.assert_allclose([found.first_m, found.last_m], [[0.6e-3, -1.2e-3], [1.8e-3, 0.0]], atol=1e-9)
    np.testing.assert_allclose(found.hole_at_m, [1.2e-3, -0.6e-3], atol=1e-9)
    assert found.hole_m == pytest.approx(6 * STEP)
    assert found.hole_deg is None, "a grid has no point of interest"


def test_the_hole_is_as_wide_as_it_is_seen_from_the_point_of_interest(whole, tmp_path):
    """Right above the point of interest a hole of radius r is seen under 2·atan(r/depth), farther away under less."""
    path = without(whole, tmp_path, lambda x, y: np.hypot(x, y) < 0.55e-3)
    recording = dataclasses.replace(open_recording(path), depth=2e-3)
    found = find_missing_points(recording)
    assert found.hole_deg == pytest.approx(degrees(2 * atan(found.hole_m / 2 / 2e-3)))
    aside = find_missing_points(dataclasses.replace(recording, offset=(2e-3, 0.0)))
    assert aside.hole_deg < found.hole_deg


def test_a_whole_scan_lacks_nothing(whole):
    assert find_missing_points(open_recording(whole)) is None


def test_reconstruct_command_warns_of_missing_points(whole, tmp_path):
    path = without(whole, tmp_path, lambda x, y: x > 0.1e-3)
    result = CliRunner().invoke(app, ["reconstruct", str(path), "--modes", "32", "-o", str(tmp_path / "out")])
    assert result.exception is None, result.output
    said = " ".join(result.output.split())
    assert "warning: 210 of 441 points (47.6 %) are not measured, within x 0.30 … 3.00 mm, y -3.00 … 3.00 mm" in said
    assert "the largest hole is 6.00 mm wide" in said
    missing = json.loads((tmp_path / "out" / "report.json").read_text())["missing"]
    assert (missing["count"], missing["planned"]) == (210, 441)
    assert missing["hole_m"] == pytest.approx(20 * STEP)


@pytest.mark.long
def test_iterative_report_states_iterations_and_misfit(whole, tmp_path):
    """While it runs and at its end: the figures are those of the library's own account of the same image."""
    stages = []
    parameters = ReconstructionParameters.create(method="iterative", modes=16, iterative={"iterations": 4})
    report = reconstruct_scan(whole, tmp_path, parameters, progress=lambda stage, *_: stages.append(stage))
    recording = open_recording(whole)
    traces = recording.traces * np.asarray(recording.scale)[:, None]
    recorded = {"dt": 16e-9, "sound_speed": 1500.0, "aperture": recording.aperture}
    acquisition = Acquisition(traces, recording.positions, **recorded)
    found = reconstruct(acquisition, ImageGrid(16), Iterative(iterations=4)).info
    assert (report.fit.iterations, report.fit.stopped) == (found.iterations, found.stop_reason)
    np.testing.assert_allclose(report.fit.misfits, found.residuals, rtol=1e-3)
    assert f"iterations, misfit {100 * found.residuals[-1]:.1f} %" in stages
    command = ["reconstruct", str(whole), "--method", "iterative", "--modes", "16", "--iterations", "4"]
    result = CliRunner().invoke(app, [*command, "-o", str(tmp_path / "out")])
    assert result.exception is None, result.output
    assert f"misfit {100 * found.residuals[-1]:.2g} %" in " ".join(result.output.split())
