"""The benchmarks run to their end and their tables hold what they promise."""

from __future__ import annotations

from steradian.benchmarks import accuracy, speed


def test_every_row_of_the_accuracy_table_keeps_its_tolerance() -> None:
    seen: list[tuple[int, int]] = []
    rows = accuracy(points=60, progress=lambda stage, done, total: seen.append((done, total)))
    assert seen[-1] == (len(rows), len(rows))
    assert {row["method"] for row in rows} == {"nedner", "ner", "linear", "nearest"}
    for row in rows:
        if row["tolerance"] is not None:
            assert row["error"] < row["tolerance"], row


def test_the_speed_benchmark_runs_every_case_in_small() -> None:
    rows = speed(quick=True, repeats=1)
    assert len(rows) == 16
    for row in rows:
        assert row["run_s"] > 0
        assert row["ratio"] > 0
        if row["shape"].count("×") == 2:  # beside the tiny images of the small 2-D cases, scratch is not small
            assert row["extra_memory"] < 1.0, row["case"]
