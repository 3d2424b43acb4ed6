"""``steradian demo``: the whole pipeline from mask to reconstruction on a simulated scanner."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from steradian.cli.console import finish_with_summary, progress_bar, show_figures
from steradian.cli.scan import new_scan_id
from steradian.cli.scanner_port import scanner_port
from steradian.core.exceptions import SteradianError

if TYPE_CHECKING:
    from steradian.imaging import Volume
    from steradian.jobs.queue.queue_client import JobQueue
    from steradian.masks import Mask
    from steradian.plans import ScanPlan
    from steradian.scans.acquisition.run import ScanSummary
    from steradian.storage.data_dir.layout import DataDirectory

APERTURE, DEPTH, COUNT = 13.56e-3, 3.6e-3, 1600
MODES = 226
DEPTHS = (1e-3, 8e-3)
"""Depths to reconstruct: the sensors' own noise gathers in the first millimetre below them."""
GRID_COUNT, GRID_INTERVAL = 41, 240e-6
"""The paper's strongest rival: 41 × 41 points, every fourth of a 60 µm grid."""
COMPARISON_DIAMETER = 7.2e-3
THRESHOLD = 0.04
"""Region in which images are compared (paper, section 5): a disc's pixels of at least 4 % of the truth's maximum."""
PHANTOM_SEED = 1
RESULTS = {".h5", ".json", ".png"}


@dataclass
class DemoReport:
    """Report of the demo, as written to ``report.json``."""

    mask_count: int = 0
    shots_fired: int = 0
    shots_stored: int = 0
    correlation: float = 0.0
    grid_count: int = 0
    grid_correlation: float = 0.0
    region: str = (
        f"z-MIP, pixels of at least {THRESHOLD:.0%} of the truth's maximum in a disc of "
        f"{1e3 * COMPARISON_DIAMETER:g} mm"
    )
    simulated: bool = True
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Context manager that records the wall time of a stage."""
        start = time.perf_counter()
        yield
        self.seconds[stage] = round(time.perf_counter() - start, 3)


def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the results of the demo.")] = Path("demo"),
    speed: Annotated[float, typer.Option(help="How much faster than real time the simulated scanner runs.")] = 20.0,
) -> None:
    """Run the whole pipeline on a simulated scanner: mask, plan, scan, queued reconstruction, projections.

    A knotted yarn 3.6 mm above the sensor is measured at 1,605 points of equal solid angle, and again on a
    41 x 41 grid for comparison. Leaves scan.h5, volume.h5, mip-x.png, mip-y.png, mip-z.png and report.json;
    results of an earlier demo in the folder are replaced.
    """
    from steradian.masks import equi_steradian_mask
    from steradian.plans import ScanPlan, preview
    from steradian.reconstructions.warmup import warmup_in_background
    from steradian.storage.data_dir.layout import DataDirectory

    report = DemoReport()
    output.mkdir(parents=True, exist_ok=True)
    with report.timed("mask"):
        mask = equi_steradian_mask(APERTURE, DEPTH, COUNT)
    report.mask_count = mask.count
    show_figures("1  Mask", {"points": mask.count, "weight ratio": f"{mask.weight_ratio:.1f}"})
    with report.timed("plan"):
        plan = ScanPlan.create(mask=mask)
        cost = preview(plan)
    bytes_, seconds = f"{cost.bytes / 1e6:.1f} MB", f"{cost.laser_seconds:.1f} s of laser at {plan.pulse_rate:g} Hz"
    show_figures("2  Plan", {"visit": f"{1e3 * cost.travel:.0f} mm, {plan.order}", "time": seconds, "A-lines": bytes_})

    with tempfile.TemporaryDirectory(prefix=".data-", dir=output) as folder:
        data, scan_id = DataDirectory(Path(folder)), new_scan_id()
        with warmup_in_background(), _queue(data) as queue:
            with report.timed("scan"):
                summary = _scan(plan, data, scan_id, speed)
            report.shots_fired, report.shots_stored = summary.fired, summary.stored
            show_figures("3  Scan (simulated)", {"shots fired": summary.fired, "A-lines stored": summary.stored})
            with report.timed("reconstruction"):
                _reconstruct_queued(queue, scan_id, data, output)
            with report.timed("comparison grid"):
                grid = _measure_grid(queue, output / "grid", data, speed)
    report.grid_count = grid.count

    with report.timed("comparison"):
        report.correlation = _compare_with_truth(output / "volume.h5")
        report.grid_correlation = _compare_with_truth(output / "grid" / "volume.h5")
    _write(output / "report.json", report)
    _show(report, output)


def _scan(plan: ScanPlan, data: DataDirectory, scan_id: str, speed: float) -> ScanSummary:
    from steradian.scans.acquisition.run import run_scan

    with scanner_port("simulated", speed=speed, seed=PHANTOM_SEED) as port, progress_bar() as progress:
        return run_scan(plan, port, data.scan_file(scan_id), scan_id=scan_id, progress=progress)


@contextmanager
def _queue(data: DataDirectory) -> Iterator[JobQueue]:
    """Yield the job queue, with a worker process that starts up during the scan."""
    from steradian.core.settings import Settings
    from steradian.jobs.queue.queue_client import JobQueue
    from steradian.runtime.supervisor import running_worker

    settings = Settings.create(data=data.root)
    with running_worker(settings), closing(JobQueue(settings)) as queue:
        yield queue


def _reconstruct_queued(queue: JobQueue, scan_id: str, data: DataDirectory, output: Path) -> None:
    """Reconstruct the scan as a queued job, then move scan file and results to the output folder."""
    from steradian.jobs.queue.queue_client import new_job_id
    from steradian.jobs.reconstruction_request import ReconstructionRequest
    from steradian.jobs.requests import to_job_request
    from steradian.storage.state_machines import ReconstructionState

    request = ReconstructionRequest.create(scan_id=scan_id, parameters={"modes": MODES, "depth_range": DEPTHS})
    with progress_bar() as progress:
        job = queue.submit(to_job_request(new_job_id(), request))
        status = queue.wait(job, progress=progress)
    if status.state is not ReconstructionState.SUCCEEDED:
        raise SteradianError(f"the reconstruction {status.state}: {status.error}")
    output.mkdir(parents=True, exist_ok=True)
    data.scan_file(scan_id).replace(output / "scan.h5")
    for result in data.job(job).root.iterdir():
        if result.suffix in RESULTS:
            result.replace(output / result.name)


def _measure_grid(queue: JobQueue, folder: Path, data: DataDirectory, speed: float) -> Mask:
    """Scan and reconstruct the same phantom with a regular grid mask, for comparison."""
    from steradian.masks import grid_mask
    from steradian.plans import ScanPlan

    grid = grid_mask(APERTURE, GRID_COUNT, GRID_INTERVAL)
    scan_id = new_scan_id()
    _scan(ScanPlan.create(mask=grid), data, scan_id, speed)
    _reconstruct_queued(queue, scan_id, data, folder)
    return grid


def _compare_with_truth(path: Path) -> float:
    from steradian.quality import correlation, disc
    from steradian.reconstructions.volumes.file import read_volume

    volume = read_volume(path)
    truth = _true_mip(volume)
    region = disc(volume.coordinates("x"), volume.coordinates("y"), COMPARISON_DIAMETER) & (
        truth >= THRESHOLD * truth.max()
    )
    return round(correlation(volume.mip("z"), truth, region), 4)


def _true_mip(volume: Volume) -> Any:
    from fabry_perot.simulator.phantoms import initial_pressure, yarn

    coordinates = (volume.coordinates(axis) for axis in "xyz")
    return initial_pressure(yarn(PHANTOM_SEED), *coordinates).max(axis=2)


def _write(path: Path, report: DemoReport) -> None:
    draft = path.with_name(path.name + ".new")
    draft.write_text(json.dumps(vars(report), indent=2) + "\n", encoding="utf-8")
    draft.replace(path)


def _show(report: DemoReport, output: Path) -> None:
    closer = (report.correlation - report.grid_correlation) / (1 - report.grid_correlation)
    show_figures(
        "4  Reconstruction, compared with the phantom",
        {
            f"{report.mask_count} equi-steradian points": f"correlation {report.correlation:.3f}",
            f"{report.grid_count} points on a grid": f"correlation {report.grid_correlation:.3f}",
            "closer to 1": f"{closer:.0%}",
            "seconds": ", ".join(f"{stage} {seconds:.1f}" for stage, seconds in report.seconds.items()),
        },
    )
    finish_with_summary(("picture", output / "mip-z.png"), ("figures", output / "report.json"), ("all", output))
