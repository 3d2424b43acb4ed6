"""The table of found speeds of sound is computed from its rows, and docs/sound-speed.md holds that of its figures."""

import json
from pathlib import Path

import pytest

from steradian_benchmarks.sound_speed import summary, table

DOCS = Path(__file__).parents[3] / "docs"


def row(found: float, error: float | None) -> dict[str, object]:
    shared = {"object": "points", "aperture_mm": 4.0, "noise_db": 30.0, "delay_us": 0.0, "true": 1500.0}
    return shared | {"found": found, "standard_error": error, "sharpest": 1500.0}


def test_summary_of_known_rows_has_their_bias_and_coverage() -> None:
    found = summary([row(1503.0, 1.0), row(1500.0, 1.0), row(1498.5, 2.0), row(1498.5, None)])
    assert found["bias"] == pytest.approx(0.0, abs=1e-9)
    assert found["rms"] == pytest.approx(100 * (13.5 / 4) ** 0.5 / 1500)
    assert found["largest"] == pytest.approx(0.2)
    assert found["held"] == pytest.approx(50.0)


def test_page_of_sound_speeds_holds_the_table_of_its_figures_and_the_promise() -> None:
    rows = json.loads((DOCS / "sound-speed.json").read_text(encoding="utf-8"))["rows"]
    assert table(rows) in (DOCS / "sound-speed.md").read_text(encoding="utf-8")
    assert len(rows) == 60
    assert abs(summary(rows)["bias"]) <= 0.1
    assert 60 <= summary(rows)["held"] <= 76
