"""Handlers of the jobs that write a volume, run in the worker's subprocess."""

from __future__ import annotations

import hashlib
import json
import logging
import time
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Final

from steradian.core.atomic_files import atomic_write, remove_older
from steradian.core.exceptions import InvalidInput
from steradian.jobs.reconstruction_request import ReconstructionRequest
from steradian.jobs.tasks.context import JobContext, open_database, result_files
from steradian.jobs.tasks.job_type import handles
from steradian.storage.blobs.interface import FolderBlobStore, result_name
from steradian.storage.data_dir.job_directory import SERIES

if TYPE_CHECKING:
    from steradian.reconstructions.live.revision_metrics import Revision
    from steradian.reconstructions.studies.what_if import TimedImage
    from steradian.scans.recording import Recording

_log = logging.getLogger(__name__)
LIVE_KIND: Final = "live"
REFERENCE_TTL = 86_400.0
"""Seconds for which the image of all A-lines is kept for other jobs."""
REFERENCE_TIMEOUT = 600.0
"""Seconds for which a job waits for the image that another one makes."""


@handles(ReconstructionRequest, "reconstruction", resource="reconstruction")
def reconstruct(work: JobContext, job: ReconstructionRequest) -> dict[str, Any]:
    """Run a reconstruction job: reconstruct a scan file and write volume, or series, and report."""
    from steradian.reconstructions.pipeline.run import reconstruct_scan
    from steradian.reconstructions.series.reconstruct import reconstruct_series
    from steradian.reconstructions.warmup import warmup_second_half
    from steradian.scans.file.read import list_frames

    scan = work.scan_path(job.scan_id)
    how: dict[str, Any] = {"motion": job.motion, "plans": work.plans, "progress": work.progress}
    with warmup_second_half():
        if len(job.series(list_frames(scan))) > 1:
            how |= {"wavelength": job.wavelength, "average": job.average, "align": job.align}
            return asdict(reconstruct_series(scan, work.folder, job.parameters, **how))
        if job.align:
            raise InvalidInput("align", "true", "a scan of several frames")
        return asdict(reconstruct_scan(scan, work.folder, job.parameters, frame=job.frames, **how))


@handles(ReconstructionRequest, "unmixing", resource="reconstruction")
def unmix(work: JobContext, job: ReconstructionRequest) -> dict[str, Any]:
    """Run an unmixing job: unmix a series into maps of chromophores and oxygen saturation."""
    from steradian.jobs.tasks.unmixing import unmix_stored

    if job.unmixing is None or job.reconstruction_id is None:
        raise InvalidInput("unmixing", None, "how to unmix, and reconstruction_id")
    series = work.arrays.open(result_name(job.reconstruction_id, SERIES))
    return asdict(unmix_stored(series, work.folder, job.unmixing, job.reconstruction_id, work.progress))


@handles(ReconstructionRequest, LIVE_KIND, resource="reconstruction", follows="A-lines")
def reconstruct_live(work: JobContext, job: ReconstructionRequest) -> dict[str, Any]:
    """Run a live job: reconstruct a growing scan in revisions, and completely at its end."""
    from sqlalchemy.exc import SQLAlchemyError

    from steradian.reconstructions.live.follow import reconstruct_live
    from steradian.storage.db.timestamps_and_ids import utc_now
    from steradian.storage.repositories.event_log import append_event
    from steradian.storage.repositories.scans import ScanRepository
    from steradian.storage.state_machines import SETTLED_SCAN_STATES

    with open_database() as database:
        scans, here = ScanRepository(database), work.data.scan_file(job.scan_id)
        scan = work.folder / here.name  # the job's own name for it, as several may follow it on a host
        scan.unlink(missing_ok=True)
        scan.symlink_to(here)

        def is_over() -> bool:
            if scans.get(job.scan_id).state not in SETTLED_SCAN_STATES:
                return False
            if not scan.exists() and not isinstance(work.arrays, FolderBlobStore):  # it was measured on another host
                kept = work.scan_path(job.scan_id)
                scan.unlink()
                scan.symlink_to(kept)
            return True

        def tell(revision: Revision) -> None:
            told = {name: getattr(revision, name) for name in ("number", "points", "planned", "final")}
            try:
                with database.write() as session:
                    append_event(session, utc_now(), "revision", work.folder.name, {"scan_id": job.scan_id, **told})
            except SQLAlchemyError as error:  # the image is there all the same
                _log.warning("revision %d is not in the log of events: %s", revision.number, error)

        how: dict[str, Any] = {"interval": job.interval, "progress": work.progress, "revised": tell}
        try:
            report = reconstruct_live(scan, work.folder, job.parameters, is_over=is_over, **how)
        finally:
            scan.unlink()
    return asdict(report)


@handles(ReconstructionRequest, "what-if", resource="reconstruction")
def reconstruct_subset(work: JobContext, job: ReconstructionRequest) -> dict[str, Any]:
    """Run a what-if job: reconstruct from a subset of the A-lines and compare with the full reconstruction."""
    from steradian.reconstructions.pipeline.report import Report
    from steradian.reconstructions.pipeline.run import reconstruct_and_write
    from steradian.reconstructions.shot_normalisation import normalise_shots
    from steradian.reconstructions.studies.what_if import TimedImage, compare_subset, select_subset
    from steradian.reconstructions.volumes.file import read_volume
    from steradian.scans.opening import open_recording
    from steradian.storage.repositories.masks import MaskRepository

    if job.through is None:
        raise InvalidInput("through", None, "the mask to look through")
    with open_database() as database:
        mask = MaskRepository(database).load(job.through.mask_id)
    scan = work.scan_path(job.scan_id)
    recording, uneven = normalise_shots(open_recording(scan), job.parameters.shots, progress=work.progress)
    sparse, _ = select_subset(recording, mask, job.through.points)
    report = reconstruct_and_write(
        sparse,
        work.folder,
        job.parameters,
        Report(shots=uneven),
        plans=work.plans,
        progress=work.progress,
    )
    figures = compare_subset(
        scan,
        mask,
        work.folder,
        job.parameters,
        points=job.through.points,
        full=_shared_reference_image(work, job, recording),
        image=TimedImage(read_volume(work.folder / "volume.h5"), report.seconds["reconstruct"]),
        progress=work.progress,
    )
    return asdict(report) | {"what_if": asdict(figures), "files": result_files(work.folder)}


def _shared_reference_image(work: JobContext, job: ReconstructionRequest, recording: Recording) -> TimedImage:
    """Return the reconstruction of all A-lines, cached on disk for the other jobs of a sweep under a lock."""
    import filelock

    from steradian._version import __version__
    from steradian.reconstructions.studies.what_if import TimedImage, timed_reconstruction
    from steradian.reconstructions.volumes.file import read_volume, write_volume

    state = work.scan_path(job.scan_id).stat()
    made_of = [__version__, job.scan_id, state.st_size, state.st_mtime_ns, job.parameters.model_dump_json()]
    path = work.data.reference(f"{job.scan_id}-{hashlib.sha256(json.dumps(made_of).encode()).hexdigest()[:24]}")
    path.parent.mkdir(parents=True, exist_ok=True)
    took = path.with_suffix(".json")
    try:
        with filelock.FileLock(path.with_suffix(".lock"), timeout=REFERENCE_TIMEOUT):
            if path.is_file() and took.is_file():
                path.touch()
                return TimedImage(read_volume(path), json.loads(took.read_text()))
            remove_older(path.parent, time.time() - REFERENCE_TTL)  # where no service looks through the folder
            image = timed_reconstruction(recording, job.parameters, progress=work.progress)
            with atomic_write(took) as file:
                file.write_text(json.dumps(image.seconds))
            write_volume(path, image.volume, parameters={}, provenance=recording.provenance, centre=recording.centre)
            return image
    except filelock.Timeout:  # who makes it is cut off
        return timed_reconstruction(recording, job.parameters, progress=work.progress)
