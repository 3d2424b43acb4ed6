"""Command groups ``reconstruction``, ``batch`` and ``job`` of the client's command line."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal

import typer

from steradian_client.cli.common import (
    Reason,
    ResourceId,
    Wait,
    add_stored,
    add_watch,
    client_of,
    command_group,
    show_when_done,
)
from steradian_client.cli.show import AsJson, Settings, print_item, progress_reporter, settings

reconstruction = command_group("Turn scans into volumes.")
batch, job = command_group("Many reconstructions of one scan."), command_group("Everything in the queue.")
NOUNS: Final = {"reconstruction": reconstruction, "batch": batch, "job": job}
Scan = Annotated[str, typer.Argument(metavar="SCAN")]
Index = Annotated[int | None, typer.Option(min=0, help="Which volume of a series.")]
Priority = Annotated[int | None, typer.Option(min=0, help="Smaller ones run first.")]

_SHOWN = ("id", "kind", "state", "progress", "created")
add_stored(reconstruction, lambda client: client.reconstructions, (*_SHOWN, "scan_id"))
add_watch(reconstruction, lambda client: client.reconstructions)
add_stored(batch, lambda client: client.batches, ("id", "state", "counts", "vary", "created"))
add_watch(batch, lambda client: client.batches)
add_stored(job, lambda client: client.jobs, _SHOWN)
add_watch(job, lambda client: client.jobs)


@reconstruction.command(
    "create", help="Queue a reconstruction, for example: create SCAN modes=226 method=iterative --wait"
)
def create_reconstruction(
    context: typer.Context,
    scan_id: Scan,
    parameters: Settings = None,
    priority: Priority = None,
    frame: Annotated[int | None, typer.Option(min=0, help="One frame of several; default: all, as a series.")] = None,
    average: Annotated[bool, typer.Option("--average", help="The mean of the frames at each wavelength.")] = False,
    wait: Wait = False,
    as_json: AsJson = False,
) -> None:
    """Queue a reconstruction of a scan."""
    those = client_of(context).reconstructions
    made = those.create(scan_id, priority=priority, frame=frame, average=average or None, **settings(parameters))
    show_when_done(those, made, wait, as_json)


@reconstruction.command(
    "unmix", help='Queue the unmixing of a series, for example: unmix SERIES fluence={"model":"fit"} --wait'
)
def unmix(
    context: typer.Context,
    series: Annotated[str, typer.Argument(metavar="SERIES")],
    options: Settings = None,
    priority: Priority = None,
    wait: Wait = False,
    as_json: AsJson = False,
) -> None:
    """Queue the unmixing of a series into maps of oxygen saturation and chromophores."""
    those = client_of(context).reconstructions
    show_when_done(those, those.unmix(series, priority=priority, **settings(options)), wait, as_json)


@reconstruction.command("cancel", help="Cancel one that waits or runs.")
def cancel_reconstruction(
    context: typer.Context, identifier: ResourceId, reason: Reason = None, as_json: AsJson = False
) -> None:
    """Cancel a queued or running reconstruction."""
    print_item(client_of(context).jobs.cancel(identifier, reason), as_json)


@reconstruction.command("volume", help="Download the volume as a NumPy file, float32 [x, y, z].")
def volume(context: typer.Context, identifier: ResourceId, target: Path, index: Index = None) -> None:
    """Download the volume of a reconstruction."""
    with progress_reporter() as progress:
        client_of(context).reconstructions.download_volume(
            identifier, target, index=index, progress=lambda done, total: progress("bytes", done, total)
        )


@reconstruction.command("mip", help="Download a maximum-intensity projection (PNG).")
def mip(
    context: typer.Context, identifier: ResourceId, target: Path, axis: Literal["x", "y", "z", "depth"] = "z"
) -> None:
    """Download a maximum-intensity projection of a reconstruction."""
    client_of(context).reconstructions.download_mip(identifier, target, axis=axis)


@reconstruction.command("export", help="Export it for other programs: hdf5, nifti, tiff, ome-zarr, vtkhdf, nrrd, png.")
def export(
    context: typer.Context, identifier: ResourceId, format: str, folder: Path = Path(), index: Index = None
) -> None:
    """Export a volume and download the files."""
    with progress_reporter() as progress:
        found = client_of(context).exports.export_and_download(
            format, folder, reconstruction_id=identifier, index=index, progress=progress
        )
    for path in found:
        print(path)


@batch.command("create", help="Queue a sweep, for example: create SCAN sound_speed=[1480,1500] --with modes=226")
def create_batch(
    context: typer.Context,
    scan_id: Scan,
    vary: Settings = None,
    common: Annotated[list[str] | None, typer.Option("--with", help="NAME=VALUE that all have.")] = None,
    each: Annotated[Literal["wavelength", "frame"] | None, typer.Option(help="A job for each.")] = None,
    wait: Wait = False,
    as_json: AsJson = False,
) -> None:
    """Queue a batch of reconstructions with varied parameters."""
    those = client_of(context).batches
    show_when_done(those, those.create(scan_id, settings(vary), each=each, **settings(common)), wait, as_json)


@batch.command("cancel", help="Cancel a batch's remaining jobs.")
def cancel_batch(
    context: typer.Context, identifier: ResourceId, reason: Reason = None, as_json: AsJson = False
) -> None:
    """Cancel the unfinished jobs of a batch."""
    print_item(client_of(context).batches.cancel(identifier, reason), as_json)


@job.command("create", help="Queue a job, for example: create sound-speed scan_id=… first=1450 last=1550")
def create_job(
    context: typer.Context, kind: str, asked: Settings = None, wait: Wait = False, as_json: AsJson = False
) -> None:
    """Queue a job other than a reconstruction."""
    those = client_of(context).jobs
    show_when_done(those, those.create(kind, **settings(asked)), wait, as_json)


@job.command("cancel", help="Cancel one that waits or runs.")
def cancel_job(context: typer.Context, identifier: ResourceId, reason: Reason = None, as_json: AsJson = False) -> None:
    """Cancel a queued or running job."""
    print_item(client_of(context).jobs.cancel(identifier, reason), as_json)


@job.command("prioritise", help="Move one that waits; smaller numbers run first.")
def prioritise(context: typer.Context, identifier: ResourceId, priority: int, as_json: AsJson = False) -> None:
    """Change the priority of a queued job."""
    print_item(client_of(context).jobs.set_priority(identifier, priority), as_json)


@job.command("log", help="Print its log.")
def log(context: typer.Context, identifier: ResourceId) -> None:
    """Print a job's log."""
    print(client_of(context).jobs.log(identifier), end="")


@job.command("file", help="Download a file that it left.")
def file(context: typer.Context, identifier: ResourceId, name: str, target: Path) -> None:
    """Download a result file of a job."""
    client_of(context).jobs.download_file(identifier, name, target)
