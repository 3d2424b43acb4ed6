"""The benchmarks run to their end and their tables hold what they promise."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steradian.benchmarks.accuracy import accuracy
from steradian.benchmarks.machine_limits import fft_pair_baselines
from steradian.benchmarks.medium_accuracy import medium_accuracy, medium_cases
from steradian.benchmarks.speed import limit_violations, speed
from steradian.benchmarks.speed_cases import speed_cases
from steradian.benchmarks.speed_report import BEGIN, END, table, write_page

pytestmark = pytest.mark.long


@pytest.mark.long
def test_accuracy_table_rows_meet_tolerance() -> None:
    seen: list[tuple[int, int]] = []
    rows = accuracy(points=60, progress=lambda stage, done, total: seen.append((done, total)))
    assert seen[-1] == (len(rows), len(rows))
    assert {row["method"] for row in rows} == {"nedner", "ner", "linear", "nearest"}
    for row in rows:
        if row["tolerance"] is not None:
            assert row["error"] < row["tolerance"], row


@pytest.mark.long
def test_medium_rows_have_small_errors_and_adjoints_to_rounding() -> None:
    rows = medium_accuracy()
    assert [row["method"] for row in rows] == [f"model: {case.name}" for case in medium_cases()]
    for row in rows:
        assert row["adjoint"] < 1e-12, row
        assert row["error"] is None or row["error"] < 0.01, row


@pytest.fixture(scope="module")
def rows() -> list[dict[str, Any]]:
    return speed(quick=True, repeats=1)


@pytest.mark.long
def test_the_speed_benchmark_runs_every_case_in_small(rows: list[dict[str, Any]]) -> None:
    assert {row["case"] for row in rows} == {case.name for case in speed_cases()}
    for row in rows:
        assert min(row["run_s"], row["one_shot_s"], row["traffic_s"], row["arithmetic_s"]) > 0
        assert min(row["ratio"], row["cpu_ratio"], row["one_shot_ratio"]) > 0
        # beside tiny images, of the small 2-D cases and of cases that show a part, scratch is not small
        if row["shape"].count("×") == 2 and row["error"] is not None:
            assert row["extra_memory"] < 1.0, row["case"]


@pytest.mark.long
def test_timed_rows_have_errors_below_tolerance(rows: list[dict[str, Any]]) -> None:
    """By direct sums; of the rows that have none the image shows a part, or the method is another."""
    errors = [row["error"] for row in rows if row["error"] is not None]
    assert len(errors) >= 8
    assert 1e-7 < min(errors)
    assert max(errors) < 1e-4


def test_cases_of_one_shape_have_one_yardstick_the_faster_of_both(rows: list[dict[str, Any]]) -> None:
    of_shape: dict[str, set[tuple[str, float]]] = {}
    for row in rows:
        of_shape.setdefault(row["shape"], set()).add((row["yardstick"], row["yardstick_s"]))
    assert all(len(found) == 1 for found in of_shape.values())


def test_both_yardsticks_give_the_array_back() -> None:
    first, *others = (pair() for pair in fft_pair_baselines((6, 5, 8), 1).values())
    for other in others:
        np.testing.assert_allclose(other, first, atol=1e-6)


def test_a_limit_that_is_exceeded_is_named() -> None:
    row = {
        "case": "x",
        "ratio": 0.6,
        "limit": 0.55,
        "one_shot_ratio": 0.7,
        "one_shot_limit": 0.75,
        "part": 1.0,
        "part_limit": None,
    }
    assert limit_violations([row, {**row, "ratio": 0.5}]) == ["x: 0.60 instead of 0.55 (ratio)"]
    assert limit_violations([{**row, "limit": None, "one_shot_ratio": 0.76}]) == [
        "x: 0.76 instead of 0.75 (one_shot_ratio)"
    ]


def test_the_page_takes_the_table_between_its_marks(rows: list[dict[str, Any]], tmp_path: Path) -> None:
    machine = {"cpus": 2, "processor": "P", "compiled_for": "itself", "python": "3.11", "load": 0.5}
    document = {"measured": "2026-01-01T00:00:00", "machine": machine, "rows": rows}
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n", encoding="utf-8")
    write_page(page, document)
    assert page.read_text(encoding="utf-8") == f"before\n{BEGIN}\n{table(document)}\n{END}\nafter\n"
    for row in rows:
        assert f"| {row['case']} | {row['sensors']:,} | {row['shape']} |" in table(document)


def test_the_committed_page_shows_the_committed_figures() -> None:
    docs = Path(__file__).parents[3] / "docs"
    shown = (docs / "performance.md").read_text(encoding="utf-8").partition(BEGIN)[2].partition(END)[0]
    assert shown.strip() == table(json.loads((docs / "performance.json").read_text(encoding="utf-8"))).strip()
