"""Repeated and gated scans: frames of a time series begin at edges of the gate, and the file says when."""

import numpy as np
import pytest

import steradian
from fabry_perot.simulator import launch
from steradian import InvalidInput, ScanPlan, grid_mask
from steradian.plans import Link, preview
from steradian.scans.acquisition.run import run_scan

MASK = grid_mask(4e-3, 5, 8e-4)
COMMON = {"mask": MASK, "samples": 64, "pulse_rate": 500.0, "order": "given", "link": Link(byte_rate=None)}
EDGES = 4.0


@pytest.mark.parametrize(("gate", "averages"), [("frame", 1), ("point", 2)])
def test_gated_scan_starts_at_gate_edge_and_takes_predicted_time(tmp_path, gate, averages):
    """By the scanner's own clock: a time series of three frames, or every point by itself."""
    frames = 3 if gate == "frame" else 1
    plan = ScanPlan.create(gate=gate, gate_rate=EDGES, frames=frames, averages=averages, **COMMON)
    with launch(gate_rate=EDGES, repeat=2, speed=20) as simulator:
        run_scan(plan, simulator.url, tmp_path / "scan.h5")
    scan = steradian.open(tmp_path / "scan.h5")
    assert [frame.stored for frame in scan.frames] == [MASK.count] * frames
    begun = np.array([frame.first_shot for frame in scan.frames])
    since_edge = begun % (1 / EDGES)
    assert (since_edge <= averages * 0.002 + 1e-5).all(), "the last shot of the first average, from an edge on"
    assert all(frame.last_shot - frame.first_shot < 1 / EDGES for frame in scan.frames) is (gate == "frame")
    cost = preview(plan)
    assert cost.limiting == "gate"
    # from the edge of the first shot to that after the last one
    ended = np.ceil(scan.frames[-1].last_shot * EDGES) / EDGES
    assert ended - np.floor(begun[0] * EDGES) / EDGES == pytest.approx(cost.total_seconds, abs=1.01 / EDGES)


def test_gated_scan_without_gate_is_refused_before_file_creation(tmp_path):
    """The field is named."""
    with launch(repeat=1) as simulator, pytest.raises(InvalidInput, match="gated"):
        run_scan(ScanPlan.create(gate="frame", **COMMON), simulator.url, tmp_path / "scan.h5")
    assert not (tmp_path / "scan.h5").exists()


def test_a_scan_that_goes_on_waits_for_the_gate_again():
    """The first point that is missing, and the first of each frame after it."""
    from steradian.scans.file.measurement_order import ScanProgram

    plan = ScanPlan.create(gate="frame", frames=3, **COMMON)
    rows = ScanProgram.of_plan(plan).order[30:]
    gated = ScanProgram.of_plan(plan).gated_points(rows)
    assert np.flatnonzero(gated).tolist() == [0, 20]


def test_plans_without_a_gate_are_named_as_before():
    """Whatever rate of edges is expected only counts with a gate; the name tells gates apart."""
    bare = ScanPlan.create(**COMMON)
    assert bare.gate == "none"
    assert len({bare.id, bare.replace(gate="frame").id, bare.replace(gate="point").id}) == 3
    assert "gate" not in preview(bare).seconds
