"""The figures of docs/which-mask.md about predictions of ``steradian design``, as measured."""

import json
from pathlib import Path

from steradian_benchmarks import budget

DOCS = Path(__file__).parents[3] / "docs"
ROWS = json.loads((DOCS / "budget.json").read_text())["rows"]


def test_predictions_agree_with_twenty_scans_and_the_page_has_their_table(tmp_path):
    assert len([row for row in ROWS if row["method"] == "direct"]) == budget.SCANS == 20
    assert budget.violations(ROWS) == []
    page = tmp_path / "which-mask.md"
    page.write_text((DOCS / "which-mask.md").read_text())
    budget.write_page(page, ROWS)
    assert page.read_text() == (DOCS / "which-mask.md").read_text()


def test_a_prediction_that_is_off_is_reported():
    row = next(row for row in ROWS if row["method"] == "direct" and row["usable"])
    off = row | {"contrast_db": row["contrast_expected_db"] - 2.1, "width_m": 1.11 * row["width_expected_m"]}
    assert len(budget.violations([off])) == 2
    assert "| direct | 1 | 0 | 2.1 dB | at most 5 % | 1 | 0 | 11% |" in budget.table([off])
