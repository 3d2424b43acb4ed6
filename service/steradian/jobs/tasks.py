"""The work of each kind of job, as it is done in a worker's child process."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from steradian.drafts import draft, sync_folder
from steradian.errors import Conflict, InvalidInput
from steradian.jobs import requests
from steradian.plain import plain
from steradian.progress import Progress
from steradian.storage.disk import imported_scan_id
from steradian.storage.paths import DataDirectory

if TYPE_CHECKING:
    from steradian.reconstructions.kept_plans import KeptPlans
    from steradian.reconstructions.what_if import Made
    from steradian.scans.recording import Recording
    from steradian.storage.database import Database

PATIENCE = 600.0
"""Seconds for which a job waits for the image that another one makes."""


@dataclass(frozen=True)
class Work:
    """Where and with what a job works.

    Attributes
    ----------
    data, folder
        The data directory, and the job's own folder in it, which has the job's name.
    principal
        Who asked for the job.
    plans
        Plans of earlier jobs of this process.
    """

    data: DataDirectory
    folder: Path
    principal: str
    plans: KeptPlans
    progress: Progress


def reconstruct(work: Work, job: requests.ReconstructionRequest) -> dict[str, Any]:
    """Reconstruct a recording."""
    from steradian.reconstructions.job import reconstruct_scan

    how: dict[str, Any] = {"frame": job.frame or 0, "plans": work.plans, "progress": work.progress}
    return asdict(reconstruct_scan(work.data.scan_file(job.scan_id), work.folder, job.parameters, **how))


def follow(work: Work, job: requests.ReconstructionRequest) -> dict[str, Any]:
    """Reconstruct a scan while it runs, and in full when it is over."""
    from steradian.reconstructions.live import follow_scan
    from steradian.storage.scans import ScanRepository
    from steradian.storage.states import SETTLED_SCAN_STATES

    with _database() as database:
        scans, scan = ScanRepository(database), work.data.scan_file(job.scan_id)

        def is_over() -> bool:
            return scans.get(job.scan_id).state in SETTLED_SCAN_STATES

        report = follow_scan(
            scan, work.folder, job.parameters, is_over=is_over, interval=job.interval, progress=work.progress
        )
    return asdict(report)


def look_through(work: Work, job: requests.ReconstructionRequest) -> dict[str, Any]:
    """Reconstruct a scan through another mask, and compare with the image of all A-lines."""
    from steradian.reconstructions.job import Report, write_reconstruction
    from steradian.reconstructions.shots import even_out
    from steradian.reconstructions.volume_file import read_volume
    from steradian.reconstructions.what_if import Made, through, what_if
    from steradian.scans.opening import open_recording
    from steradian.storage.masks import MaskRepository

    if job.through is None:
        raise InvalidInput("through", None, "the mask to look through")
    with _database() as database:
        mask = MaskRepository(database).load(job.through.mask_id)
    scan = work.data.scan_file(job.scan_id)
    recording, uneven = even_out(open_recording(scan), job.parameters.shots)
    sparse, _ = through(recording, mask, job.through.points)
    report = write_reconstruction(
        sparse,
        work.folder,
        job.parameters,
        Report(shots=uneven),
        plans=work.plans,
        progress=work.progress,
    )
    figures = what_if(
        scan,
        mask,
        work.folder,
        job.parameters,
        points=job.through.points,
        full=_image_of_all(work, job, recording),
        image=Made(read_volume(work.folder / "volume.h5"), report.seconds["reconstruct"]),
        progress=work.progress,
    )
    return asdict(report) | {"what_if": asdict(figures), "files": _left(work.folder)}


def _image_of_all(work: Work, job: requests.ReconstructionRequest, recording: Recording) -> Made:
    """Return the image of all A-lines; a sweep's first job makes it, the others wait for it and read it."""
    import filelock

    from steradian import __version__
    from steradian.reconstructions.volume_file import read_volume, write_volume
    from steradian.reconstructions.what_if import Made, make

    state = work.data.scan_file(job.scan_id).stat()
    made_of = [__version__, job.scan_id, state.st_size, state.st_mtime_ns, job.parameters.model_dump_json()]
    path = work.data.reference(f"{job.scan_id}-{hashlib.sha256(json.dumps(made_of).encode()).hexdigest()[:24]}")
    path.parent.mkdir(parents=True, exist_ok=True)
    took = path.with_suffix(".json")
    try:
        with filelock.FileLock(path.with_suffix(".lock"), timeout=PATIENCE):
            if path.is_file() and took.is_file():
                path.touch()
                return Made(read_volume(path), json.loads(took.read_text()))
            image = make(recording, job.parameters, progress=work.progress)
            with draft(took) as file:
                file.write_text(json.dumps(image.seconds))
            write_volume(path, image.volume, parameters={}, provenance=recording.provenance)
            return image
    except filelock.Timeout:  # who makes it is cut off
        return make(recording, job.parameters, progress=work.progress)


def scan_speeds(work: Work, job: requests.SoundSpeedRequest) -> dict[str, Any]:
    """Find the speed of sound at which a scan's image is sharpest."""
    from steradian.reconstructions.sound_speed import scan_sound_speed

    curve = scan_sound_speed(
        work.data.scan_file(job.scan_id),
        work.folder,
        job.parameters,
        first=job.first,
        last=job.last,
        steps=job.steps,
        progress=work.progress,
    )
    return asdict(curve) | {"files": _left(work.folder)}


def compare_volumes(work: Work, job: requests.QualityRequest) -> dict[str, Any]:
    """Compare a volume with a reference."""
    from steradian.quality import compare
    from steradian.reconstructions.volume_file import read_volume

    images = []
    for number, identifier in enumerate((job.reconstruction_id, job.reference_id)):
        work.progress("reading", number, 2)
        images.append(read_volume(work.data.job(identifier).volume))
    work.progress("comparing", 0, 1)
    figures = compare(images[0], images[1], diameter=job.diameter, threshold=job.threshold)
    whole = plain(figures)
    with draft(work.folder / "quality.json") as file:
        file.write_text(json.dumps(whole, indent=2) + "\n")
    return {"figures": whole, "files": ["quality.json"]}


def export(work: Work, job: requests.ExportRequest) -> dict[str, Any]:
    """Write a volume or scan in another format; a format that is a folder is packed into a zip archive."""
    wanted = work.folder / f"{job.reconstruction_id or job.scan_id}{requests.SUFFIXES[job.format]}"
    if job.scan_id is not None:
        from steradian.scans.exporting import export_scan

        made = export_scan(work.data.scan_file(job.scan_id), wanted, format="ipasc", progress=work.progress)
    else:
        from steradian.reconstructions.exporting import export_volume

        volume = work.data.job(job.reconstruction_id or "").volume
        made = export_volume(volume, wanted, format=job.format, progress=work.progress)  # type: ignore[arg-type]
    if made.is_dir():
        work.progress("packing", 0, 1)
        packed = made.with_name(f"{made.name}.zip")
        with draft(packed, keep_ending=True) as beside:
            shutil.make_archive(str(beside.with_suffix("")), "zip", made.parent, made.name)
        shutil.rmtree(made)
        made = packed
    return {"files": [made.name], "bytes": made.stat().st_size}


def import_recording(work: Work, job: requests.ImportRequest) -> dict[str, Any]:
    """Make a scan of an upload: its file is looked at here and nowhere else."""
    from steradian.reconstructions.imported import read_imported
    from steradian.scans.importing.guarded import import_guarded
    from steradian.storage.imports import register_import

    uploads = [work.data.upload(name) for name in (job.upload_id, job.companion_id) if name is not None]
    scan_id = imported_scan_id(work.folder.name)
    scan = work.data.scan_file(scan_id)
    if not scan.is_file():  # else an earlier attempt got that far
        if not all(upload.is_file() for upload in uploads):
            raise Conflict("an upload is gone; send the file again")
        source, description = _unpacked(work.folder, job, *uploads)
        with draft(scan) as file:
            import_guarded(source, file, description=description, progress=work.progress)
        sync_folder(scan.parent)
    said = read_imported(scan)
    about: dict[str, Any] = {"labels": job.labels, "who": work.principal}
    with _database() as database:
        register_import(database, said.plan, scan_id, simulated=said.simulated, summary=said.summary, **about)
    for upload in uploads:
        upload.unlink(missing_ok=True)
    return {"scan_id": scan_id, "plan_id": said.plan.id, "mask_id": said.plan.mask.id, **said.summary}


def _unpacked(
    folder: Path, job: requests.ImportRequest, upload: Path, companion: Path | None = None
) -> tuple[Path, Path | None]:
    """Give uploads the names by which the importer knows text files and a description its companion."""
    source = folder / ("source.csv" if _is_text(upload) else "source")
    source.unlink(missing_ok=True)
    source.symlink_to(upload)
    said = dict(job.description or {})
    if companion is not None:
        beside = folder / "companion"
        beside.unlink(missing_ok=True)
        beside.symlink_to(companion)
        said["positions"] = beside.name
    if not said:
        return source, None
    description = folder / "description.json"
    description.write_text(json.dumps(said))
    return source, description


def _is_text(path: Path) -> bool:
    with path.open("rb") as file:
        begin = file.read(1024)
    return b"\0" not in begin and begin.isascii() and begin[:1] != b"\x89" and begin[:2] != b"PK"


@contextmanager
def _database() -> Iterator[Database]:
    from steradian.settings import Settings
    from steradian.storage.database import Database, metadata_url

    database = Database(metadata_url(Settings.create()))
    try:
        yield database
    finally:
        database.close()


def _left(folder: Path) -> list[str]:
    """Name the files of results in a job's folder."""
    kinds = {".json", ".png", ".h5", ".csv", ".npy"}
    return sorted(path.name for path in folder.iterdir() if path.suffix in kinds and path.is_file())
