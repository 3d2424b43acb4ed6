"""The page on beams says what was measured, and what it claims follows from its figures."""

import json
from pathlib import Path

import pytest

from steradian.masks import equi_steradian_mask, multi_beam_mask
from steradian.masks.multi_beam import read_beams
from steradian.plans import Link, ScanPlan
from steradian_benchmarks.beams import BEGIN, END, _times, table, write_page

DOCS = Path(__file__).parents[3] / "docs"
ROWS = json.loads((DOCS / "beams.json").read_text())["rows"]


def test_the_page_is_that_of_its_figures(tmp_path):
    page = tmp_path / "beams.md"
    page.write_text((DOCS / "beams.md").read_text())
    write_page(page, ROWS)
    assert page.read_text() == (DOCS / "beams.md").read_text()
    assert f"{BEGIN}\n{table(ROWS)}\n{END}" in page.read_text()


def test_sixteen_beams_take_a_sixteenth_of_the_time_by_plan_and_by_the_hardwares_clock():
    fewest = [row for row in ROWS if row["beams"] == 16 and row["places"] == 101]
    assert ROWS[0]["points"] == 1605
    assert len(fewest) == 3  # patterns
    for row in fewest:
        assert row["expected_s"] / ROWS[0]["expected_s"] == pytest.approx(101 / 1605)
        assert row["share"] == pytest.approx(101 / 1605, rel=0.01)
        assert row["bound"] < row["share"] < 1.01 * row["bound"]


def test_multi_beam_projection_quality_matches_single_beam():
    """The difference to one beam's is no larger than three times what the choice of points makes."""
    for row in ROWS:
        if row["beams"] == 16:
            assert abs(row["mip"] - ROWS[0]["mip"]) < 3 * max(row["mip_sd"], ROWS[0]["mip_sd"])


def test_with_an_eighth_more_places_volumes_are_as_good_and_with_the_fewest_they_are_not():
    """What the page says of the square of 0.5 mm and of the row: within one standard deviation, or beyond two."""
    found = {(row["kind"], row.get("spacing_m"), row["places"]): row for row in ROWS}
    for pattern in (("4x4", 0.5e-3), ("16", 0.4e-3)):
        most, fewest = (found[*pattern, places] for places in (113, 101))
        assert most["share"] < 1 / 14
        assert most["volume"] > ROWS[0]["volume"] - ROWS[0]["volume_sd"]
        assert fewest["volume"] < ROWS[0]["volume"] - 2 * fewest["volume_sd"]


@pytest.mark.long
def test_simulated_multi_beam_scan_time_matches_preview():
    alone = equi_steradian_mask(13.56e-3, 3.6e-3, 100)
    pattern = read_beams("3", 0.5e-3)
    plan = ScanPlan.create(mask=multi_beam_mask(alone, pattern), beams=pattern, link=Link(byte_rate=None))
    row = _times(plan)
    assert row["simulated_s"] == pytest.approx(row["expected_s"], rel=0.01)
    assert row["expected_s"] == pytest.approx(len(plan.beam_positions) / 50)
