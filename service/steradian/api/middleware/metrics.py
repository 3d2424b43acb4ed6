"""Prometheus metrics: request counters, and a collector of queue, scan and process state."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import suppress

from prometheus_client import CollectorRegistry, Counter, Histogram
from prometheus_client.metrics_core import GaugeMetricFamily
from prometheus_client.registry import Collector

from steradian._version import __version__
from steradian.api.services import ServiceContainer
from steradian.jobs.queue.estimates import backlog
from steradian.jobs.queue.matching import count_unsatisfiable, present_workers
from steradian.runtime.heartbeat import gpu_of, is_alive
from steradian.storage.state_machines import ReconstructionState, ScanState

BUCKETS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0)


class Metrics:
    """Prometheus metrics: counters of HTTP requests, and a collector of queue and process state."""

    def __init__(self, services: ServiceContainer) -> None:
        self.registry = CollectorRegistry()
        labels = ("method", "route", "status")
        self._requests = Counter("steradian_http_requests", "Requests served", labels, registry=self.registry)
        self._seconds = Histogram(
            "steradian_http_request_seconds", "Until the answer began", ("method", "route"),
            buckets=BUCKETS, registry=self.registry,
        )  # fmt: skip
        self.registry.register(_StateCollector(services))

    def observe_request(self, method: str, route: str, status: int, seconds: float) -> None:
        """Record status and latency of a request under its route template, so that identifiers create no series."""
        self._requests.labels(method, route, str(status)).inc()
        self._seconds.labels(method, route).observe(seconds)


class _StateCollector(Collector):
    """Collector that reads queue, scan and process state at scrape time."""

    def __init__(self, services: ServiceContainer) -> None:
        self._services = services

    def describe(self) -> list[GaugeMetricFamily]:
        """Return no metric families in advance, because their collection needs the database."""
        return []

    def collect(self) -> Iterator[GaugeMetricFamily]:
        """Collect the current state of queue, scans, workers, processes and disk."""
        services = self._services
        version = GaugeMetricFamily("steradian_info", "Version of the software", labels=["version"])
        version.add_metric([__version__], 1)
        yield version
        for name, states, counts in (
            ("jobs", ReconstructionState, services.ledger.counts()),
            ("scans", ScanState, services.scans.counts()),
        ):
            family = GaugeMetricFamily(f"steradian_{name}", f"{name.capitalize()} in each state", labels=["state"])
            for state in states:
                family.add_metric([str(state)], counts.get(str(state), 0))
            yield family
        with services.ledger.database.read() as session:
            present = present_workers(session, now := services.ledger.clock())
            waiting, unmet = backlog(session, now, present), count_unsatisfiable(session, present)
        if waiting.seconds is not None:
            told = "Estimated time of one worker for all queued jobs; absent without past jobs to estimate from"
            yield GaugeMetricFamily("steradian_jobs_waiting_work_seconds", told, waiting.seconds)
        told = "Age of the oldest queued job"
        yield GaugeMetricFamily("steradian_jobs_waiting_oldest_seconds", told, waiting.oldest)
        told = "Jobs that wait and that no worker which is present can do"
        yield GaugeMetricFamily("steradian_jobs_waiting_unmet", told, unmet)
        told, labels = "Capabilities of each worker that was present recently", ["worker", "memory", "cores", "gpu"]
        family = GaugeMetricFamily("steradian_worker", told, labels=labels)
        for name, has in present.items():
            family.add_metric([name, str(has.memory or ""), str(has.cores), has.gpu or ""], 1)
        yield family
        alive = GaugeMetricFamily(
            "steradian_process_alive", "Whether a process shows signs of life", labels=["process"]
        )
        gpus = GaugeMetricFamily("steradian_gpu", "GPU that a worker uses", labels=["process", "gpu"])
        for process in _processes(services):
            if process not in {"owner", "service"}:
                sign = services.data.heartbeat(process)
                alive.add_metric([process], is_alive(sign, time.time()))
                if (gpu := gpu_of(sign)) is not None:
                    gpus.add_metric([process, gpu], 1)
        yield alive
        yield gpus
        with suppress(OSError):  # the data folder is away
            free = services.disk.free
            yield GaugeMetricFamily("steradian_disk_free_bytes", "Free on the disk of the data folder", value=free)
        yield GaugeMetricFamily("steradian_events_last", "Number of the last event", value=services.log.bounds().last)


def _processes(services: ServiceContainer) -> list[str]:
    """Return the names of processes that have a heartbeat file; none while the data folder is unavailable."""
    try:
        return sorted(path.stem for path in services.data.heartbeat("x").parent.glob("*.json"))
    except OSError:
        return []
