"""``python -m steradian_benchmarks queue`` in small: it measures what it says and finds nothing lost."""

import pytest

from steradian.core.settings import Settings
from steradian_benchmarks.queue import latency, load, throughput

pytestmark = [pytest.mark.soak, pytest.mark.timeout(300)]


def test_queue_throughput_is_jobs_over_seconds_with_processor_time(tmp_path):
    settings = Settings.create(data=tmp_path, port=0, workers=2, simulator_speed=200.0)
    row = throughput(settings, jobs=4, modes=16, points=60)
    assert row["jobs_per_second"] == pytest.approx(4 / row["seconds"])
    assert row["cpu_s_per_job"] > 0


def test_queue_latency_percentiles_are_plausible_for_single_jobs(tmp_path):
    row = latency(Settings.create(data=tmp_path, port=0), jobs=4)
    assert 0 < row["start_p50_ms"] < 5000
    assert 0 <= row["progress_p50_ms"] < 5000


def test_a_small_load_loses_and_doubles_nothing(tmp_path):
    settings = Settings.create(data=tmp_path, port=0, workers=2, simulator_speed=200.0)
    row = load(settings, jobs=12, readers=2)
    assert (row["succeeded"], row["doubled"]) == (12, 0)
    assert row["read_p99_ms"] > row["bare_select_p50_ms"]
