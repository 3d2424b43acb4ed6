"""``steradian benchmark scale`` in small: nodes serve what one service serves, and the page holds what was measured."""

import pytest

from steradian.benchmarks.mixed_load import WEIGHTS
from steradian.benchmarks.queueing_model import load_of_scanners
from steradian.benchmarks.scale import MULTI_NODE, SINGLE_SERVICE, _with_shares, scale
from steradian.benchmarks.scale_report import BEGIN, END, tables, write_page


@pytest.mark.soak
@pytest.mark.timeout(900)
def test_scale_benchmark_covers_single_and_multi_node_without_errors(tmp_path, postgres, seaweed):
    shared = {"database_url": postgres.database(), "store": seaweed.bucket(), "store_endpoint": seaweed.endpoint}
    rows = scale(shared, seconds=10, clients=10, streams=3, jobs=3)
    for where in (SINGLE_SERVICE, MULTI_NODE):
        (total,) = [row for row in rows if row["case"] == "total" and row["where"] == where]
        assert (total["server_errors"], total["alines_lost"], total["scan"]) == (0, 0, "complete")
        assert {row["route"] for row in rows if row["case"] == "route" and row["where"] == where} > set(WEIGHTS)
    assert [row["workers"] for row in rows if row["case"] == "jobs"] == [1, 1, 3]
    (came,) = [row for row in rows if row["case"] == "arrivals"]
    assert 0 <= came["waited_s"] < 100
    assert all(row["store_gb_per_day"] > 0 and 0 < row["event_lock"] for row in rows if row["case"] == "scanners")
    page = tmp_path / "scale.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    write_page(page, rows)
    assert "old" not in page.read_text()


def test_scale_table_computes_share_from_single_worker_cost(monkeypatch):
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    about = {"case": "jobs", "jobs": 10}
    folder = {
        "where": "folder, 1 worker",
        "workers": 1,
        "seconds_per_job": 1.0,
        "cpu_s_per_job": 1.5,
        "machine_s_per_job": 1.5,
    }
    store = {
        "where": "store, 1 worker",
        "workers": 1,
        "seconds_per_job": 1.25,
        "cpu_s_per_job": 1.2,
        "machine_s_per_job": 1.6,
    }
    three = {
        "where": "store, 3 workers",
        "workers": 3,
        "seconds_per_job": 0.9,
        "cpu_s_per_job": 1.3,
        "machine_s_per_job": 1.7,
    }
    rows = [about | row | {"jobs_per_second": 1 / row["seconds_per_job"]} for row in (folder, store, three)]
    shown = tables(_with_shares(rows)).splitlines()[2:]
    # two processors make 2 / 1.6 = 1.25 jobs a second of 1.6 s each; three workers make 1 / 0.9 = 1.11 of them
    assert shown == [
        "| folder, 1 worker | 1.00 | 1.00 | +0.00 | 1.50 | 1.50 | 0.75 |",
        "| store, 1 worker | 0.80 | 1.25 | +0.25 | 1.20 | 1.60 | 0.64 |",
        "| store, 3 workers | 1.11 | 0.90 |  | 1.30 | 1.70 | 0.89 |",
    ]


def test_every_kind_of_row_has_its_place_on_the_page():
    spent = {"seconds_per_job": 2.0, "jobs_per_second": 0.5, "cpu_s_per_job": 1.0, "machine_s_per_job": 1.5}
    jobs = [{"case": "jobs", "jobs": 9, "workers": 1, "where": where} | spent for where in ("folder", "store")]
    came = {
        "case": "arrivals",
        "jobs": 40,
        "busy": 0.71,
        "waited_s": 2.2,
        "modelled_s": 2.1,
        "low_s": 1.9,
        "high_s": 2.4,
    }
    many = load_of_scanners([2.0], api_cpu_s=0.01, scan_bytes=4e6, volume_bytes=2.4e8, events=20, event_s=0.005)
    met = {
        "case": "total",
        "where": MULTI_NODE,
        "clients": 200,
        "streams": 20,
        "seconds": 60.0,
        "requests_per_second": 99.5,
    }
    met |= {"api_cpu_ms_per_request": 3.0, "clients_cpu_ms_per_request": 0.5, "server_errors": 0, "statuses": {}}
    met |= {
        "events": 7,
        "events_lost": 0,
        "events_again": 0,
        "jobs_succeeded": 3,
        "alines": 10,
        "alines_lost": 0,
        "scan": "complete",
    }
    page = tables([*_with_shares(jobs), came, met, *many])
    assert "40 jobs that came by chance, one worker busy for 71% of the time, waited 2.20 s in the mean" in page
    assert "the model says 2.10 s (1.90 to 2.40)" in page
    # 20 scans in ten hours, with two jobs each, 300 requests of 10 ms, 4 and 2 × 240 MB, 20 events of 5 ms
    assert "| 1 | 0.001 | 1 | 0.00 | 0.010 | 0.0% |" in page
    assert "| 1,000 | 1.111 |" in page
    assert "| 1.67 | 9.680 | 5.6% |" in page
    assert f"### Clients of {MULTI_NODE}" in page
