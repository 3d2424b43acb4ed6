"""Benchmarks of operators: small versions run, limits are checked, and learned masks are judged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="PyTorch: pip install --no-deps -r constraints-operators.txt")
learned = pytest.importorskip("steradian_benchmarks.learned_positions")
operators = pytest.importorskip("steradian_benchmarks.operators")
report = pytest.importorskip("steradian_benchmarks.learned_positions_report")


def test_times_are_ratios_to_the_bare_products_and_a_slow_gradient_is_a_violation(tmp_path: Path) -> None:
    rows = operators.operators(quick=True, repeats=1)
    by_case = {row["case"]: row for row in rows}
    assert by_case[operators.BARE]["ratio"] == 1
    assert len(by_case) == 7
    by_case[operators.BY_IMAGE]["ratio"] = 1.2
    assert operators.violations(rows) == [f"{operators.BY_IMAGE}: 1.20 of the two bare products, above 1.1"]
    page = tmp_path / "page.md"
    page.write_text("before\n" + "\n".join(operators.MARKS) + "\nafter\n")
    operators.write_page(page, rows)
    assert f"| {operators.BY_IMAGE} |" in page.read_text()


def test_positions_and_weights_are_moved_or_weights_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(learned, "TRAINED", 2)
    monkeypatch.setattr(learned, "MODES", 24)
    begin = learned.begin("grid")
    for method, moving in (("direct", True), ("direct", False), ("iterative", True)):
        trainer = learned.Trainer(begin, "yarn", method)
        losses = trainer.learn(2, moving=moving)
        mask = trainer.mask()
        assert all(0 < loss < 1 for loss in losses)
        assert np.abs(mask.positions).max() <= learned.APERTURE / 2
        assert (np.abs(mask.positions - begin.positions).max() > 1e-6) == moving
        assert (np.ptp(trainer.logarithm.detach().numpy()) > 1e-3) == (method == "direct")


def test_a_learned_mask_is_judged_by_the_gap_that_it_closes() -> None:
    rows = [{"mask": "grid", "yarn_direct": 0.7}, {"mask": "random", "yarn_direct": 0.6}]
    found = {"mask": "learned", "start": "grid", "yarn_direct": 0.76}
    assert report.gap_closed([*rows, found], found, "yarn_direct") == pytest.approx(0.2)
