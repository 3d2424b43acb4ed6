"""Benchmark of scans in stages: tables, claims and pages from given figures."""

import json
from pathlib import Path

import numpy as np
import pytest

from steradian_benchmarks import design_by_gradient, stages, stages_enough, stages_report

DOCS = Path(__file__).parents[3] / "docs"
ROWS = json.loads((DOCS / "stages.json").read_text())["rows"]


def focus_row(seed, staged, true, distance):
    row = {"part": "focus", "points": 500, "depth_m": 2e-3, "seed": seed, "distance_m": distance}
    for name, value in (("guess", 0.5), ("grid", 0.4), ("staged", staged), ("true", true)):
        row |= {f"{name}_direct": value, f"{name}_iterative": value + 0.2}
    return row


def enough_row(seed, share, loss):
    row = {"part": "enough", "points": 1605, "seed": seed, "stopped_at": round(1605 * share), "share": share}
    return row | {"expected_change": 0.02, "actual_change": 0.01, "direct_loss": loss, "iterative_loss": loss / 2}


FOCUS = [focus_row(0, 0.68, 0.69, 0.1e-3), focus_row(1, 0.66, 0.65, 0.2e-3)]
ENOUGH = [enough_row(0, 0.7, 0.002), enough_row(1, 0.75, 0.004)]


def test_page_is_that_of_its_figures_and_the_claims_hold(tmp_path):
    page = tmp_path / "stages.md"
    page.write_text((DOCS / "stages.md").read_text())
    stages_report.write_page(page, ROWS)
    assert page.read_text() == (DOCS / "stages.md").read_text()
    assert stages_report.violations(ROWS) == []
    assert len(stages_report.part_of(ROWS, "focus")) == 40
    assert len(stages_report.part_of(ROWS, "enough")) == 15


def test_gradient_of_the_design_is_that_of_differences(monkeypatch):
    monkeypatch.setattr(design_by_gradient, "BALLS", 60)
    balls = design_by_gradient._balls(0)
    places = np.random.default_rng(1).uniform(-1e-3, 2e-3, (12, 2))
    _, slope = design_by_gradient._error(places, balls)
    for sensor, axis in ((0, 0), (5, 1), (11, 0)):
        moved = [places.copy(), places.copy()]
        moved[0][sensor, axis] -= 1e-6
        moved[1][sensor, axis] += 1e-6
        low, high = (design_by_gradient._error(each, balls)[0] for each in moved)
        assert slope[sensor, axis] == pytest.approx((high - low) / 2e-6, rel=0.05, abs=0.02 * np.abs(slope).max())


def test_optimised_design_has_a_smaller_expected_error(monkeypatch):
    monkeypatch.setattr(design_by_gradient, "BALLS", 60)
    places = np.random.default_rng(1).uniform(-2.5e-3, 2.5e-3, (12, 2))
    balls = design_by_gradient._balls(0)
    moved = design_by_gradient.optimise(places, steps=6)
    assert design_by_gradient._error(moved, balls)[0] < 0.95 * design_by_gradient._error(places, balls)[0]


def test_focus_table_has_means_and_the_worst():
    table = stages_report.focus_table(FOCUS)
    assert "| 500 | 2 | grid | 0.400 | 0.400 | 0.600 | 0.600 |" in table
    assert "| 500 | 2 | **survey, then focus** | **0.670** | **0.660** | **0.870** | **0.860** |" in table
    assert "found 2 of 2 objects, 100% of all within 0.5 mm" in table
    assert "average 0.15 mm, at most 0.20 mm" in table


def test_enough_table_has_means_and_the_worst():
    assert "| 1,605 | 1,164 | 28% | 0.020 | 0.010 | 0.0030 (0.0040) | 0.0015 (0.0020) |" in stages_report.enough_table(
        ENOUGH
    )


def test_claims_that_hold_have_no_violation():
    assert stages_report.violations(FOCUS + ENOUGH) == []


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([focus_row(0, 0.67, 0.69, 0.1e-3)], "0.670, below 0.690"),
        ([focus_row(0, 0.7, 0.69, 0.6e-3)], "found within 0.5 mm: 0%"),
        ([focus_row(0, 0.7, 0.69, None)], "found within 0.5 mm: 0%"),
        ([*FOCUS, enough_row(0, 0.8, 0.001)], "pulses saved: 20.0%"),
        ([*FOCUS, enough_row(0, 0.7, 0.006)], "direct_loss: 0.0060"),
    ],
)
def test_claim_that_does_not_hold_is_named(rows, message):
    assert message in "\n".join(stages_report.violations(rows))


def test_page_gets_both_tables(tmp_path):
    page = tmp_path / "stages.md"
    page.write_text("\n".join(["before", *stages_report.FOCUS, "between", *stages_report.ENOUGH, "after"]))
    stages_report.write_page(page, FOCUS + ENOUGH)
    text = page.read_text()
    assert stages_report.focus_table(FOCUS) in text
    assert stages_report.enough_table(ENOUGH) in text
    assert text.startswith("before")
    assert text.endswith("after")


def test_random_places_keep_the_region_over_the_aperture():
    for seed in range(20):
        x, y, depth = stages.random_place(2e-3, seed)
        assert max(abs(x), abs(y)) + stages.REGION / 2 <= stages.APERTURE / 2
        assert depth == 2e-3


@pytest.mark.long
def test_quick_benchmark_has_rows_of_both_parts():
    rows = stages_report.measure(quick=True)
    assert [row["part"] for row in rows] == ["focus", "enough"]
    assert rows[0]["staged_direct"] > rows[0]["grid_direct"]
    assert rows[1]["stopped_at"] <= rows[1]["points"] <= 1.1 * 300
    assert stages_enough.violations(rows[1:]) == []
