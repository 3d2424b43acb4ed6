"""Waiting times of jobs in the queue: queueing model and measurement."""

from __future__ import annotations

import heapq
import time
from collections.abc import Sequence
from datetime import datetime
from typing import Any

import numpy as np

from steradian.benchmarks.service import RunningService, wait_for_reconstruction
from steradian.core.validation import FloatArray

BUSY = 0.7
"""Share of the time for which workers are busy when the waiting is measured."""
DRAWN = 400
"""How often the model draws what may have happened."""
PATIENCE = 60.0
"""Seconds that nineteen jobs in twenty may wait, when workers are counted."""
SCANNERS = (1, 10, 100, 1000)
SCANS, HOURS, JOBS, LOOKS = 20, 10.0, 2, 300
"""A scanner's day: scans, within these hours, reconstructions of each, requests of those who look at each."""
Row = dict[str, Any]


def fifo_waiting_times(arrivals: FloatArray, services: FloatArray, workers: int) -> FloatArray:
    """Return the modelled waiting time of each job (seconds) in a first-in, first-out queue of several workers.

    The recursion of Kiefer and Wolfowitz (1955) for any times between arrivals and any service times.

    Parameters
    ----------
    arrivals
        When jobs come, ascending (N,).
    services
        For how long each holds its worker (N,).
    """
    free = [0.0] * workers
    waits = np.empty(len(arrivals))
    for number, (comes, lasts) in enumerate(zip(arrivals.tolist(), services.tolist(), strict=True)):
        begins = max(comes, free[0])
        heapq.heapreplace(free, begins + lasts)
        waits[number] = begins - comes
    return waits


def measure_poisson_arrivals(
    service: RunningService, scan_id: str, modes: int, *, jobs: int, lasts: float, seed: int = 1
) -> Row:
    """Submit jobs to one worker at random times; return measured and modelled waiting times.

    Parameters
    ----------
    lasts
        How long one takes (seconds): they come so fast that the worker is busy for :data:`BUSY` of the time.

    Returns
    -------
    dict
        ``waited_s`` is the mean of all; ``modelled_s`` the mean, and with ``low_s`` and ``high_s`` nineteen in twenty,
        of what the model finds for the same moments, each time with the measured service times in another order; who
        finds the worker idle waits as the median of those did.
    """
    chance = np.random.default_rng(seed)
    gaps = chance.exponential(lasts / BUSY, jobs)
    body = {"scan_id": scan_id, "parameters": {"modes": modes}}
    made, begun = [], time.monotonic()
    for moment in np.cumsum(gaps):
        time.sleep(max(0.0, begun + moment - time.monotonic()))
        made.append(service.request("/reconstructions", body)["id"])
    done = [wait_for_reconstruction(service, identifier) for identifier in made]
    created, started, ended = (
        np.array([datetime.fromisoformat(job[name]).timestamp() for job in done])
        for name in ("created", "started", "ended")
    )
    # what lies between the end of one and the start of the next that waits for it holds the worker too
    waited = np.concatenate([[False], created[1:] < ended[:-1]])
    between = float(np.median((started[1:] - ended[:-1])[waited[1:]])) if waited.any() else 0.0
    pickup = float(np.median((started - created)[~waited]))  # a worker without work looks for it now and then
    lasting = ended - started + between
    drawn = (fifo_waiting_times(created - created[0], chance.permutation(lasting), 1) for _ in range(DRAWN))
    means = [np.where(waits > 0, waits, pickup).mean() for waits in drawn]
    return {
        "case": "arrivals",
        "jobs": jobs,
        "busy": float(lasting.sum() / (ended[-1] - created[0])),
        "waited_s": float((started - created).mean()),
        "modelled_s": float(np.mean(means)),
        "low_s": float(np.quantile(means, 0.025)),
        "high_s": float(np.quantile(means, 0.975)),
        "lasting_s": lasting.tolist(),
    }


def required_workers(rate: float, lasting: Sequence[float], together: int = JOBS, seed: int = 1) -> int:
    """Return the smallest number of workers with which 95 % of the jobs wait at most :data:`PATIENCE`.

    Parameters
    ----------
    rate
        Jobs a second, coming by chance.
    lasting
        Service times from which those of the model are drawn.
    together
        How many come at once.
    """
    chance = np.random.default_rng(seed)
    jobs = 20_000
    arrivals = np.repeat(np.cumsum(chance.exponential(together / rate, jobs // together)), together)
    services = chance.choice(np.asarray(lasting, float), jobs)
    workers = max(1, int(rate * np.mean(lasting)))
    while np.quantile(fifo_waiting_times(arrivals, services, workers)[jobs // 10 :], 0.95) > PATIENCE:
        workers += 1
    return workers


def load_of_scanners(
    lasting: Sequence[float], api_cpu_s: float, scan_bytes: float, volume_bytes: float, events: float, event_s: float
) -> list[Row]:
    """Return the daily load that a number of scanners causes in each part of the service.

    Parameters
    ----------
    lasting
        Seconds for which jobs hold a worker.
    api_cpu_s
        Processor time of a request.
    scan_bytes, volume_bytes
        What a scan and a volume put into the store.
    events, event_s
        Events of a scan with its jobs; seconds for which one holds the lock that puts them in order.
    """
    rows = []
    for count in SCANNERS:
        scans = count * SCANS / (HOURS * 3600)
        rows.append(
            {
                "case": "scanners",
                "scanners": count,
                "jobs_per_second": scans * JOBS,
                "workers": required_workers(scans * JOBS, lasting),
                "api_processors": scans * LOOKS * api_cpu_s,
                "store_gb_per_day": 1e-9 * count * SCANS * (scan_bytes + JOBS * volume_bytes),
                "event_lock": scans * events * event_s,
            }
        )
    return rows
