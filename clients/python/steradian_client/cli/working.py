"""Commands: reconstruction, batch, job."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal

import typer

from steradian_client.cli.common import Id, Reason, Wait, add_stored, add_watch, client_of, finish, noun
from steradian_client.cli.show import AsJson, Settings, live, settings, show

reconstruction = noun("Turn scans into volumes.")
batch, job = noun("Many reconstructions of one scan."), noun("Everything in the queue.")
NOUNS: Final = {"reconstruction": reconstruction, "batch": batch, "job": job}
Scan = Annotated[str, typer.Argument(metavar="SCAN")]
Priority = Annotated[int | None, typer.Option(min=0, help="Smaller ones run first.")]

_SHOWN = ("id", "kind", "state", "progress", "created")
add_stored(reconstruction, lambda client: client.reconstructions, (*_SHOWN, "scan_id"))
add_watch(reconstruction, lambda client: client.reconstructions)
add_stored(batch, lambda client: client.batches, ("id", "state", "counts", "vary", "created"))
add_watch(batch, lambda client: client.batches)
add_stored(job, lambda client: client.jobs, _SHOWN)
add_watch(job, lambda client: client.jobs)


@reconstruction.command("create", help="Queue a reconstruction, such as: create SCAN modes=226 method=iterative --wait")
def create_reconstruction(
    context: typer.Context,
    scan_id: Scan,
    parameters: Settings = None,
    priority: Priority = None,
    wait: Wait = False,
    as_json: AsJson = False,
) -> None:
    """Queue a reconstruction."""
    those = client_of(context).reconstructions
    finish(those, those.create(scan_id, priority=priority, **settings(parameters)), wait, as_json)


@reconstruction.command("cancel", help="Cancel one that waits or runs.")
def cancel_reconstruction(
    context: typer.Context, identifier: Id, reason: Reason = None, as_json: AsJson = False
) -> None:
    """Cancel a reconstruction."""
    show(client_of(context).reconstructions.cancel(identifier, reason), as_json)


@reconstruction.command("volume", help="Download the volume as a NumPy file, float32 [x, y, z].")
def volume(context: typer.Context, identifier: Id, target: Path) -> None:
    """Download the volume."""
    with live() as progress:
        client_of(context).reconstructions.save_volume(
            identifier, target, progress=lambda done, total: progress("bytes", done, total)
        )


@reconstruction.command("mip", help="Download a maximum-intensity projection (PNG).")
def mip(context: typer.Context, identifier: Id, target: Path, axis: Literal["x", "y", "z", "depth"] = "z") -> None:
    """Download a projection."""
    client_of(context).reconstructions.save_mip(identifier, target, axis=axis)


@reconstruction.command("export", help="Write it for other programs: hdf5, nifti, tiff, ome-zarr, vtkhdf, nrrd, png.")
def export(context: typer.Context, identifier: Id, format: str, folder: Path = Path()) -> None:
    """Export a volume and download the files."""
    with live() as progress:
        found = client_of(context).exports.run(format, folder, reconstruction_id=identifier, progress=progress)
    for path in found:
        print(path)


@batch.command("create", help="Queue a sweep, such as: create SCAN sound_speed=[1480,1500] --with modes=226")
def create_batch(
    context: typer.Context,
    scan_id: Scan,
    vary: Settings = None,
    common: Annotated[list[str] | None, typer.Option("--with", help="NAME=VALUE that all have.")] = None,
    each: Annotated[Literal["wavelength", "frame"] | None, typer.Option(help="A job for each.")] = None,
    wait: Wait = False,
    as_json: AsJson = False,
) -> None:
    """Queue a sweep."""
    those = client_of(context).batches
    finish(those, those.create(scan_id, settings(vary), each=each, **settings(common)), wait, as_json)


@batch.command("cancel", help="Cancel what is left of a batch.")
def cancel_batch(context: typer.Context, identifier: Id, reason: Reason = None, as_json: AsJson = False) -> None:
    """Cancel the unfinished jobs of a batch."""
    show(client_of(context).batches.cancel(identifier, reason), as_json)


@job.command("create", help="Queue work, such as: create sound-speed scan_id=… first=1450 last=1550")
def create_job(
    context: typer.Context, kind: str, asked: Settings = None, wait: Wait = False, as_json: AsJson = False
) -> None:
    """Queue a job other than a reconstruction."""
    those = client_of(context).jobs
    finish(those, those.create(kind, **settings(asked)), wait, as_json)


@job.command("cancel", help="Cancel one that waits or runs.")
def cancel_job(context: typer.Context, identifier: Id, reason: Reason = None, as_json: AsJson = False) -> None:
    """Cancel a job."""
    show(client_of(context).jobs.cancel(identifier, reason), as_json)


@job.command("prioritise", help="Move one that waits; smaller numbers run first.")
def prioritise(context: typer.Context, identifier: Id, priority: int, as_json: AsJson = False) -> None:
    """Move a job that waits."""
    show(client_of(context).jobs.prioritise(identifier, priority), as_json)


@job.command("log", help="Print what it wrote while it ran.")
def log(context: typer.Context, identifier: Id) -> None:
    """Print a job's log."""
    print(client_of(context).jobs.log(identifier), end="")


@job.command("file", help="Download a file that it left.")
def file(context: typer.Context, identifier: Id, name: str, target: Path) -> None:
    """Download a file that a job left."""
    client_of(context).jobs.save_file(identifier, name, target)
