"""``steradian benchmark scale`` in small: nodes serve what one service serves, and the page holds what was measured."""

import pytest

from steradian.benchmarks.mixed import WEIGHTS
from steradian.benchmarks.scale import ALONE, NODES, _with_shares, scale
from steradian.benchmarks.scale_page import BEGIN, END, tables, write_page


@pytest.mark.soak
@pytest.mark.timeout(900)
def test_nodes_serve_what_one_service_serves(tmp_path, postgres, seaweed):
    shared = {"database_url": postgres.database(), "store": seaweed.bucket(), "store_endpoint": seaweed.endpoint}
    rows = scale(shared, seconds=10, clients=10, streams=3, jobs=3)
    for where in (ALONE, NODES):
        (total,) = [row for row in rows if row["case"] == "total" and row["where"] == where]
        assert (total["server_errors"], total["alines_lost"], total["scan"]) == (0, 0, "complete")
        assert {row["route"] for row in rows if row["case"] == "route" and row["where"] == where} > set(WEIGHTS)
    assert [row["workers"] for row in rows if row["case"] == "jobs"] == [1, 1, 3]
    (came,) = [row for row in rows if row["case"] == "arrivals"]
    assert came["low_s"] <= came["modelled_s"] <= came["high_s"]
    assert all(row["store_gb_per_day"] > 0 and 0 < row["event_lock"] for row in rows if row["case"] == "scanners")
    page = tmp_path / "scale.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    write_page(page, rows)
    assert "old" not in page.read_text()


def test_a_share_is_of_what_the_processors_could_do_with_what_a_job_costs_one_worker(monkeypatch):
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    about = {"case": "jobs", "jobs": 10}
    folder = {"where": "folder, 1 worker", "workers": 1, "seconds_per_job": 1.0, "cpu_s_per_job": 1.5}
    store = {"where": "store, 1 worker", "workers": 1, "seconds_per_job": 1.25, "cpu_s_per_job": 1.6}
    three = {"where": "store, 3 workers", "workers": 3, "seconds_per_job": 0.9, "cpu_s_per_job": 1.7}
    rows = [about | row | {"jobs_per_second": 1 / row["seconds_per_job"]} for row in (folder, store, three)]
    shown = tables(_with_shares(rows)).splitlines()[2:]
    # two processors make 2 / 1.6 = 1.25 jobs a second of 1.6 s each; three workers make 1 / 0.9 = 1.11 of them
    assert shown == [
        "| folder, 1 worker | 1.00 | 1.00 | +0.00 | 1.50 | 0.80 |",
        "| store, 1 worker | 0.80 | 1.25 | +0.25 | 1.60 | 0.64 |",
        "| store, 3 workers | 1.11 | 0.90 |  | 1.70 | 0.89 |",
    ]
