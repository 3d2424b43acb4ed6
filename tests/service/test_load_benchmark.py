"""``steradian benchmark load`` in small: every kind of client is served, and the page holds what was measured."""

import pytest

from steradian.benchmarks.load import WEIGHTS, load
from steradian.benchmarks.load_page import BEGIN, END, write_page
from steradian.benchmarks.service import running_service
from steradian.settings import Settings


@pytest.mark.long
def test_a_benchmark_finds_the_service_that_it_starts(tmp_path):
    with running_service(Settings.create(data=tmp_path, port=0, workers=0)) as service:
        assert service.ask("/masks") == {"items": []}


@pytest.mark.soak
@pytest.mark.timeout(600)
def test_nothing_is_lost_under_a_small_load(tmp_path):
    rows = load(seconds=10, clients=10, streams=3)
    kinds = {kind: [row for row in rows if row["case"] == kind] for kind in ("route", "total", "reads", "rude")}
    (total,) = kinds["total"]
    assert (total["server_errors"], total["alines_lost"], total["scan"]) == (0, 0, "complete")
    assert total["events"] > 0
    assert total["jobs_succeeded"] > 0
    assert {row["route"] for row in kinds["route"]} > set(WEIGHTS)
    met = {row["clients"]: row["met_with"] for row in kinds["rude"]}
    for what in ("headers", "bodies"):
        assert met[f"300 half-sent {what}"] == {"closed": 300, "kept": 0}
    for what in ("of positions", "where a few bytes belong"):
        assert met[f"60 MiB {what}"] == {"413": 2}, "the refusal can be read"
    page = tmp_path / "load.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    write_page(page, rows)
    text = page.read_text()
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "old" not in text
    assert all(f"| {row['clients']} |" in text for row in kinds["rude"])
