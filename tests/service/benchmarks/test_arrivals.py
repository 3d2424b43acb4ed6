"""The model of the queue against the closed forms of queueing theory."""

from itertools import pairwise
from math import factorial

import numpy as np
import pytest

from steradian.benchmarks import queueing_model
from steradian.benchmarks.queueing_model import SCANNERS, fifo_waiting_times, load_of_scanners, required_workers


def erlang_c(load, workers):
    """The probability that a job waits, where arrivals and service times are exponential (Erlang, 1917)."""
    last = load**workers / factorial(workers) * workers / (workers - load)
    return last / (sum(load**n / factorial(n) for n in range(workers)) + last)


@pytest.mark.parametrize(("load", "workers"), [(0.7, 1), (2.4, 3), (8.5, 10)])
def test_the_mean_wait_is_that_of_erlangs_formula(load, workers):
    chance, jobs = np.random.default_rng(3), 300_000
    come = np.cumsum(chance.exponential(1.0, jobs))
    waits = fifo_waiting_times(come, chance.exponential(load, jobs), workers)
    assert waits.mean() == pytest.approx(erlang_c(load, workers) * load / (workers - load), rel=0.06)
    assert (waits > 1e-9).mean() == pytest.approx(erlang_c(load, workers), rel=0.03)


def test_the_mean_wait_of_equal_jobs_is_that_of_pollaczek_and_khinchine():
    """Half of what it is where service times are exponential."""
    chance, jobs, load = np.random.default_rng(4), 300_000, 0.7
    come = np.cumsum(chance.exponential(1.0, jobs))
    assert fifo_waiting_times(come, np.full(jobs, load), 1).mean() == pytest.approx(load**2 / 2 / (1 - load), rel=0.04)


def test_required_workers_is_minimum_for_wait_limit(monkeypatch):
    monkeypatch.setattr(queueing_model, "PATIENCE", 5.0)
    chance = np.random.default_rng(5)
    lasting = chance.exponential(4.0, 5000)

    def late(workers, load=12.0):  # P(W > t) = C exp(-(c - a) t / s)
        return erlang_c(load, workers) * np.exp(-(workers - load) * 5.0 / 4.0)

    enough = next(workers for workers in range(13, 40) if late(workers) <= 0.05)
    assert required_workers(3.0, lasting, together=1) == enough
    assert required_workers(3.0, lasting, together=4) > enough


def test_load_scales_linearly_with_scanners_and_workers_sublinearly():
    rows = load_of_scanners([30.0] * 10, api_cpu_s=0.003, scan_bytes=5e6, volume_bytes=2e8, events=40, event_s=0.002)
    assert [row["scanners"] for row in rows] == list(SCANNERS)
    for fewer, more in pairwise(rows):
        for part in ("jobs_per_second", "api_processors", "store_gb_per_day", "event_lock"):
            assert more[part] == pytest.approx(10 * fewer[part])
        assert fewer["workers"] <= more["workers"] <= 10 * fewer["workers"]
    # 20 scans of two volumes; 1,000 scanners make 1.11 jobs of 30 s a second
    assert rows[0]["store_gb_per_day"] == pytest.approx(20 * (5e6 + 4e8) / 1e9)
    assert rows[-1]["workers"] >= 1.11 * 30
