"""Handlers of the job kinds, run in the worker's subprocess."""

from __future__ import annotations

import hashlib
import json
import logging
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from steradian.core.atomic_files import atomic_write, remove_older, sync_folder
from steradian.core.exceptions import Conflict, InvalidInput
from steradian.core.json_encoding import to_jsonable
from steradian.jobs import requests
from steradian.jobs.tasks.context import JobContext
from steradian.jobs.tasks.job_type import handles
from steradian.storage.blobs.interface import FolderBlobStore, result_name, scan_name, upload_name
from steradian.storage.data_dir.job_directory import VOLUME

if TYPE_CHECKING:
    from steradian.reconstructions.live.revision_metrics import Revision
    from steradian.reconstructions.studies.what_if import TimedImage
    from steradian.scans.recording import Recording
    from steradian.storage.db.database import Database

_log = logging.getLogger(__name__)
LIVE_KIND: Final = "live"
REFERENCE_TTL = 86_400.0
"""Seconds for which the image of all A-lines is kept for other jobs."""
REFERENCE_TIMEOUT = 600.0
"""Seconds for which a job waits for the image that another one makes."""


@handles(requests.ReconstructionRequest, "reconstruction", resource="reconstruction")
def reconstruct(work: JobContext, job: requests.ReconstructionRequest) -> dict[str, Any]:
    """Run a reconstruction job: reconstruct a scan file and write volume and report."""
    from steradian.reconstructions.pipeline.run import reconstruct_scan
    from steradian.reconstructions.warmup import warmup_second_half

    how: dict[str, Any] = {"frame": job.frames, "plans": work.plans, "progress": work.progress}
    with warmup_second_half():
        return asdict(reconstruct_scan(work.scan_path(job.scan_id), work.folder, job.parameters, **how))


@handles(requests.ReconstructionRequest, LIVE_KIND, resource="reconstruction", follows="A-lines")
def reconstruct_live(work: JobContext, job: requests.ReconstructionRequest) -> dict[str, Any]:
    """Run a live job: reconstruct a growing scan in revisions, and completely at its end."""
    from sqlalchemy.exc import SQLAlchemyError

    from steradian.reconstructions.live.follow import reconstruct_live
    from steradian.storage.db.timestamps_and_ids import utc_now
    from steradian.storage.repositories.event_log import append_event
    from steradian.storage.repositories.scans import ScanRepository
    from steradian.storage.state_machines import SETTLED_SCAN_STATES

    with _database() as database:
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


@handles(requests.ReconstructionRequest, "what-if", resource="reconstruction")
def reconstruct_subset(work: JobContext, job: requests.ReconstructionRequest) -> dict[str, Any]:
    """Run a what-if job: reconstruct from a subset of the A-lines and compare with the full reconstruction."""
    from steradian.reconstructions.pipeline.run import Report, reconstruct_and_write
    from steradian.reconstructions.shot_normalisation import normalise_shots
    from steradian.reconstructions.studies.what_if import TimedImage, compare_subset, select_subset
    from steradian.reconstructions.volumes.file import read_volume
    from steradian.scans.opening import open_recording
    from steradian.storage.repositories.masks import MaskRepository

    if job.through is None:
        raise InvalidInput("through", None, "the mask to look through")
    with _database() as database:
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
    return asdict(report) | {"what_if": asdict(figures), "files": _result_files(work.folder)}


def _shared_reference_image(work: JobContext, job: requests.ReconstructionRequest, recording: Recording) -> TimedImage:
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


@handles(requests.SoundSpeedRequest)
def scan_sound_speed(work: JobContext, job: requests.SoundSpeedRequest) -> dict[str, Any]:
    """Run a sound-speed job: find the speed of sound at which a scan's image is sharpest."""
    from steradian.reconstructions.studies.sound_speed_search import scan_sound_speed

    curve = scan_sound_speed(
        work.scan_path(job.scan_id),
        work.folder,
        job.parameters,
        first=job.first,
        last=job.last,
        steps=job.steps,
        progress=work.progress,
    )
    return asdict(curve) | {"files": _result_files(work.folder)}


@handles(requests.QualityRequest)
def compare_volumes(work: JobContext, job: requests.QualityRequest) -> dict[str, Any]:
    """Run a quality job: compare a reconstruction with a reference reconstruction."""
    from steradian.quality import compare
    from steradian.reconstructions.volumes.file import read_volume

    images = []
    for number, identifier in enumerate((job.reconstruction_id, job.reference_id)):
        work.progress("reading", number, 2)
        images.append(read_volume(work.arrays.open(result_name(identifier, VOLUME))))
    work.progress("comparing", 0, 1)
    figures = compare(images[0], images[1], diameter=job.diameter, threshold=job.threshold)
    whole = to_jsonable(figures)
    with atomic_write(work.folder / "quality.json") as file:
        file.write_text(json.dumps(whole, indent=2) + "\n")
    return {"figures": whole, "files": ["quality.json"]}


@handles(requests.WidthRequest)
def measure_object(work: JobContext, job: requests.WidthRequest) -> dict[str, Any]:
    """Run a width job: measure an object's width in a volume and correct it for the point spread."""
    from steradian.reconstructions.studies.width import measure_width
    from steradian.reconstructions.volumes.file import read_parameters, read_volume
    from steradian.scans.opening import open_recording

    file = work.arrays.open(result_name(job.reconstruction_id, VOLUME))
    found = measure_width(
        read_volume(file),
        open_recording(work.scan_path(job.scan_id), job.frames),
        job.start,
        job.end,
        parameters=read_parameters(file),
        progress=work.progress,
    )
    whole = {"width": to_jsonable(asdict(found))}
    with atomic_write(work.folder / "width.json") as beside:
        beside.write_text(json.dumps(whole, indent=2) + "\n")
    return whole | {"files": ["width.json"]}


@handles(requests.ExportRequest)
def export(work: JobContext, job: requests.ExportRequest) -> dict[str, Any]:
    """Run an export job: write a volume or scan in another format; folder formats become a zip archive."""
    wanted = work.folder / f"{job.reconstruction_id or job.scan_id}{requests.SUFFIXES[job.format]}"
    if job.scan_id is not None:
        from steradian.scans.exporting import export_scan

        notes: list[str] = []
        made = export_scan(
            work.scan_path(job.scan_id),
            wanted,
            format=job.format,
            frame=job.frame,
            notes=notes,
            progress=work.progress,
        )
        return {"files": [made.name], "bytes": made.stat().st_size, "notes": notes}
    from steradian.reconstructions.exporting import export_volume

    volume = work.arrays.open(result_name(job.reconstruction_id or "", VOLUME))
    made = export_volume(volume, wanted, format=job.format, progress=work.progress)
    if made.is_dir():
        work.progress("packing", 0, 1)
        packed = made.with_name(f"{made.name}.zip")
        with atomic_write(packed, keep_ending=True) as beside:
            shutil.make_archive(str(beside.with_suffix("")), "zip", made.parent, made.name)
        shutil.rmtree(made)
        made = packed
    return {"files": [made.name], "bytes": made.stat().st_size}


@handles(requests.ImportRequest)
def import_recording(work: JobContext, job: requests.ImportRequest) -> dict[str, Any]:
    """Run an import job: convert an uploaded file to a scan file and register the scan in the database."""
    from steradian.reconstructions.scan_plan_reader import read_stored_plan
    from steradian.scans.importing.sandbox import import_in_sandbox
    from steradian.scans.importing.staging import stage_upload
    from steradian.storage.repositories.imports import imported_scan_id, register_import

    uploads = [upload_name(name) for name in (job.upload_id, job.companion_id) if name is not None]
    scan_id = imported_scan_id(work.folder.name)
    if work.arrays.stat(scan_name(scan_id)) is None:  # else an earlier attempt got that far
        if not all(work.arrays.stat(upload) for upload in uploads):
            raise Conflict("an upload is gone; send the file again")
        source, description = stage_upload(work.folder, job.description, *map(work.arrays.open, uploads))
        with atomic_write(scan := work.data.scan_file(scan_id)) as file:
            import_in_sandbox(source, file, description=description, progress=work.progress)
        sync_folder(scan.parent)
        work.arrays.put_and_commit(scan_name(scan_id), scan)
    said = read_stored_plan(work.scan_path(scan_id))
    about: dict[str, Any] = {"labels": job.labels, "who": work.principal}
    with _database() as database:
        register_import(database, said.plan, scan_id, simulated=said.simulated, summary=said.summary, **about)
    for upload in uploads:
        work.arrays.delete(upload)
    return {
        "scan_id": scan_id,
        "plan_id": said.plan.id,
        "mask_id": said.plan.mask.id,
        **said.summary,
        "notes": said.notes,
    }


@contextmanager
def _database() -> Iterator[Database]:
    from steradian.core.settings import Settings
    from steradian.storage.db.database import Database, metadata_url

    database = Database(metadata_url(Settings.create()))
    try:
        yield database
    finally:
        database.close()


def _result_files(folder: Path) -> list[str]:
    """Return the names of the result files in a job's folder."""
    kinds = {".json", ".png", ".h5", ".csv", ".npy"}
    return sorted(path.name for path in folder.iterdir() if path.suffix in kinds and path.is_file())
