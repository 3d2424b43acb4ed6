"""Handlers of the jobs beside reconstructions, run in the worker's subprocess."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from steradian.core.atomic_files import atomic_write, sync_folder
from steradian.core.exceptions import Conflict, InvalidInput
from steradian.core.json_encoding import to_jsonable
from steradian.jobs import requests
from steradian.jobs.figure_request import FigureRequest
from steradian.jobs.tasks.context import JobContext, open_database, result_files
from steradian.jobs.tasks.job_type import handles
from steradian.storage.blobs.interface import scan_name, upload_name

if TYPE_CHECKING:
    from steradian.imaging import Volume


@handles(requests.SoundSpeedRequest)
def scan_sound_speed(work: JobContext, job: requests.SoundSpeedRequest) -> dict[str, Any]:
    """Run a sound-speed job: find the speed of sound of a scan, or the parameters of its medium."""
    from steradian.reconstructions.studies.medium_scan import scan_medium
    from steradian.reconstructions.studies.sound_speed_search import scan_sound_speed

    scan, options = work.scan_path(job.scan_id), dict[str, Any](progress=work.progress)
    if job.is_of_medium:
        found = asdict(scan_medium(scan, work.folder, job.parameters, job.search, span=job.span, **options))
    else:
        found = asdict(
            scan_sound_speed(
                scan, work.folder, job.parameters, first=job.first, last=job.last, steps=job.steps, **options
            )
        )
    return found | {"files": result_files(work.folder)}


@handles(requests.QualityRequest)
def compare_volumes(work: JobContext, job: requests.QualityRequest) -> dict[str, Any]:
    """Run a quality job: compare a reconstruction with a reference reconstruction."""
    from steradian.quality import compare
    from steradian.reconstructions.volumes.file import read_volume

    images = []
    both = ((job.reconstruction_id, job.index), (job.reference_id, job.reference_index))
    for number, (identifier, index) in enumerate(both):
        work.progress("reading", number, 2)
        images.append(read_volume(work.volume_path(identifier), index))
    work.progress("comparing", 0, 1)
    figures = compare(images[0], images[1], diameter=job.diameter, threshold=job.threshold)
    whole = to_jsonable(figures)
    with atomic_write(work.folder / "quality.json") as file:
        file.write_text(json.dumps(whole, indent=2) + "\n")
    return {"figures": whole, "files": ["quality.json"]}


@handles(requests.WidthRequest)
def measure_object(work: JobContext, job: requests.WidthRequest) -> dict[str, Any]:
    """Run a width job: measure an object's width in a volume and correct it for the point spread."""
    from steradian.reconstructions.series.file import is_series_file, read_frames
    from steradian.reconstructions.studies.width import measure_width
    from steradian.reconstructions.volumes.file import read_parameters, read_volume
    from steradian.scans.opening import open_recording

    file = work.volume_path(job.reconstruction_id)
    volume = read_volume(file, job.index)
    is_of_series = job.index is not None and is_series_file(file)
    frames = read_frames(file)[job.index or 0].choice if is_of_series else job.frames
    found = measure_width(
        volume,
        open_recording(work.scan_path(job.scan_id), frames),
        job.start,
        job.end,
        parameters=read_parameters(file),
        progress=work.progress,
    )
    whole = {"width": to_jsonable(asdict(found))}
    with atomic_write(work.folder / "width.json") as beside:
        beside.write_text(json.dumps(whole, indent=2) + "\n")
    return whole | {"files": ["width.json"]}


@handles(requests.RegionsRequest)
def measure_regions(work: JobContext, job: requests.RegionsRequest) -> dict[str, Any]:
    """Run a regions job: statistics of regions in each volume of a series, and their courses over time."""
    from steradian.quality import summarise_courses, write_csv, write_regions
    from steradian.reconstructions.series.series import open_as_series

    series, (regions, background) = open_as_series(work.volume_path(job.reconstruction_id)), job.built()
    rows: list[dict[str, Any]] = []
    for number in range(len(series)):
        work.progress("volumes", number, len(series))
        rows += series.part([number]).measure(regions, background)
    courses = summarise_courses(rows, job.fit)
    write_csv(rows, work.folder / "regions.csv")
    write_csv(courses, work.folder / "courses.csv")
    write_regions(work.folder / "regions.json", regions, background)
    return {"rows": rows, "courses": courses, "files": ["regions.csv", "courses.csv", "regions.json"]}


@handles(FigureRequest)
def draw_figure(work: JobContext, job: FigureRequest) -> dict[str, Any]:
    """Run a figure job: projections of volumes side by side as PDF, SVG or PNG, or a film of a series."""
    from steradian.reconstructions.display import draw_volumes, frame_name
    from steradian.reconstructions.series.series import open_as_series

    series = open_as_series(work.volume_path(job.reconstruction_id))
    indices = range(len(series)) if job.indices is None else job.indices
    if wrong := [index for index in indices if not 0 <= index < len(series)]:
        raise InvalidInput("indices", wrong[0], f"0 to {len(series) - 1}")
    options: dict[str, Any] = {"axis": job.axes or job.axis, "slab": job.slab.by_axis(), "region": job.region.by_axis()}
    options |= {name: getattr(job, name) for name in ("near_field", "colour_map", "limits", "label")}
    options |= {"gamma": job.gamma, "log_range_db": job.log_range_db}
    if job.format != "gif":
        options |= {name: getattr(job, name) for name in ("depth_coded", "dpi", "font_size", "interpolation")}
        options["width"] = 1e3 * job.width
    if job.overlay is not None:
        other = open_as_series(work.volume_path(job.overlay.reconstruction_id))
        options["overlay"] = other[job.overlay.index or 0]
        own = ("colour_map", "limits", "label", "opacity")
        options["overlay_options"] = {name: getattr(job.overlay, name) for name in own}
    names = [frame_name(series.frames[index]) if len(series) > 1 else "" for index in indices]

    def volumes() -> Iterator[tuple[Volume, str]]:
        for number, (index, name) in enumerate(zip(indices, names, strict=True)):
            work.progress("volumes", number, len(names))
            yield series[index], name

    file = work.folder / f"{job.reconstruction_id}.{job.format}"
    made = draw_volumes(volumes(), file, film=job.format == "gif", **options)
    return {"files": [made.name], "bytes": made.stat().st_size}


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
    from steradian.reconstructions.exporting.series import export_series
    from steradian.reconstructions.series.file import is_series_file

    file = work.volume_path(job.reconstruction_id or "")
    if job.index is None and is_series_file(file):
        made = export_series(file, wanted, format=job.format, progress=work.progress)
    else:
        made = export_volume(file, wanted, format=job.format, index=job.index, progress=work.progress)
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
    with open_database() as database:
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
