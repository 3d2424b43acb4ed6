"""Command groups ``mask``, ``plan``, ``scan`` and ``scanner`` of the client's command line."""

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
from steradian_client.cli.show import AsJson, Settings, print_item, print_table, progress_reporter, settings
from steradian_client.resources.scanners import SCANNER

mask, plan = command_group("Where to sense."), command_group("Order and timing of the measurement.")
scan, scanner = (
    command_group("Run plans on the scanner."),
    command_group("The scanner, its lease and the emergency stop."),
)
NOUNS: Final = {"mask": mask, "plan": plan, "scan": scan, "scanner": scanner}
Fence = Annotated[int | None, typer.Option("--lease", help="Number of the lease that you hold.")]

add_stored(mask, lambda client: client.masks, ("id", "count", "aperture", "depth", "created"))
add_stored(plan, lambda client: client.plans, ("id", "mask_id", "pulse_rate", "samples", "created"))
add_stored(scan, lambda client: client.scans, ("id", "state", "progress", "labels", "created"))
add_watch(scan, lambda client: client.scans)


@mask.command(
    "create", help="Create a mask, for example: create equi-steradian aperture=13.56e-3 depth=3.6e-3 count=1600"
)
def create_mask(
    context: typer.Context,
    arrangement: str,
    parameters: Settings = None,
    preview: Annotated[bool, typer.Option("--preview", help="Only print the preview; create nothing.")] = False,
    as_json: AsJson = False,
) -> None:
    """Create a mask, or preview a mask with its metrics."""
    masks, chosen = client_of(context).masks, settings(parameters)
    print_item(masks.preview(arrangement, **chosen) if preview else masks.create(arrangement, **chosen), as_json)


@mask.command("points", help="Print positions and weights as JSON.")
def points(context: typer.Context, identifier: ResourceId) -> None:
    """Print positions and weights of a mask's points."""
    print_item(client_of(context).masks.points(identifier), True)


@mask.command("picture", help="Save a picture (PNG).")
def picture(context: typer.Context, identifier: ResourceId, target: Path) -> None:
    """Save a picture (PNG) of a mask."""
    client_of(context).masks.save_picture(identifier, target)


@plan.command("create", help="Create a plan of a mask, for example: create MASK pulse_rate=50")
def create_plan(
    context: typer.Context,
    mask_id: Annotated[str, typer.Argument(metavar="MASK")],
    parameters: Settings = None,
    preview: Annotated[bool, typer.Option("--preview", help="Only print the cost; create nothing.")] = False,
    as_json: AsJson = False,
) -> None:
    """Create a scan plan, or preview its cost."""
    plans, chosen = client_of(context).plans, settings(parameters)
    print_item(plans.preview(mask_id, **chosen) if preview else plans.create(mask_id, **chosen), as_json)


@scan.command("create", help="Queue a run of a plan; NAME=VALUE pairs are its labels.")
def create_scan(
    context: typer.Context,
    plan_id: Annotated[str, typer.Argument(metavar="PLAN")],
    labels: Annotated[list[str] | None, typer.Argument(metavar="[NAME=VALUE]...")] = None,
    wait: Wait = False,
    lease: Fence = None,
    completes: Annotated[
        str | None, typer.Option(metavar="SCAN", help="Start with this scan's A-lines and measure the missing ones.")
    ] = None,
    scanner: Annotated[
        str | None, typer.Option(metavar="NAME", help="Scanner that runs it, if there are several.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Queue a run of a plan as a scan."""
    scans = client_of(context).scans
    texts = {name: str(value) for name, value in settings(labels).items()}
    made = scans.create(plan_id, labels=texts, lease=lease, completes=completes, scanner_id=scanner)
    show_when_done(scans, made, wait, as_json)


@scan.command("wish", help="Pause, resume, stop (keeps the measured A-lines) or abort a scan.")
def set_desired_state(
    context: typer.Context,
    identifier: ResourceId,
    state: Literal["paused", "running", "stopped", "aborted"],
    reason: Reason = None,
    lease: Fence = None,
    as_json: AsJson = False,
) -> None:
    """Pause, resume, stop or abort a scan by setting its desired state."""
    scans = client_of(context).scans
    if state == "running":
        print_item(scans.resume(identifier, reason, lease=lease), as_json)
    else:
        ask = {"paused": scans.pause, "stopped": scans.stop, "aborted": scans.abort}[state]
        print_item(ask(identifier, reason), as_json)


@scan.command("coverage", help="Count how much of the mask is measured.")
def coverage(context: typer.Context, identifier: ResourceId, as_json: AsJson = False) -> None:
    """Count the measured points of a scan's mask."""
    print_item(client_of(context).scans.coverage(identifier), as_json)


@scan.command("file", help="Download the scan file (HDF5).")
def download(context: typer.Context, identifier: ResourceId, target: Path) -> None:
    """Download the scan file of a scan."""
    with progress_reporter() as progress:
        client_of(context).scans.save_file(
            identifier, target, progress=lambda done, total: progress("bytes", done, total)
        )


@scan.command("import", help="Import a recording as a scan; NAME=VALUE pairs give values that are not in the file.")
def import_(
    context: typer.Context,
    source: Path,
    description: Settings = None,
    companion: Annotated[Path | None, typer.Option(help="File of the positions, or k-Wave's input file.")] = None,
    as_json: AsJson = False,
) -> None:
    """Import a recording file as a scan."""
    said = settings(description) or None
    with progress_reporter() as progress:
        found = client_of(context).imports.import_file(source, description=said, companion=companion, progress=progress)
    print_item(found, as_json)


@scanner.command("list", help="Show all scanners.")
def list_scanners(context: typer.Context, as_json: AsJson = False) -> None:
    """Print a table of all scanners."""
    columns = ("id", "connection", "state", "laser", "interlock", "fault", "since", "lease", "emergency_stop")
    print_table(client_of(context).scanners.list(), columns, as_json)


@scanner.command("lease", help="Be the one operator for a while; prints the lease's number.")
def take_lease(
    context: typer.Context,
    holder: str,
    seconds: Annotated[float, typer.Option(min=1)] = 600.0,
    note: Annotated[str | None, typer.Option()] = None,
    lease: Fence = None,
    as_json: AsJson = False,
) -> None:
    """Acquire the lease of a scanner, or extend it."""
    print_item(client_of(context).scanners.take_lease(holder, seconds=seconds, note=note, lease=lease), as_json)


@scanner.command("give-back", help="End a lease.")
def return_lease(context: typer.Context, lease: Annotated[int, typer.Argument(help="Its number.")]) -> None:
    """Release the lease of a scanner."""
    client_of(context).scanners.return_lease(lease)


@scanner.command("stop", help="Emergency stop: switch the laser off and abort running and queued scans.")
def stop(context: typer.Context, reason: Reason = None, scanner_id: str = SCANNER, as_json: AsJson = False) -> None:
    """Trigger the emergency stop of a scanner."""
    print_item(client_of(context).scanners.emergency_stop(reason, scanner_id=scanner_id), as_json)


@scanner.command("stop-all", help="Emergency stop of every scanner.")
def stop_all(context: typer.Context, reason: Reason = None) -> None:
    """Trigger the emergency stop of every scanner."""
    for name, pressed in client_of(context).scanners.stop_all(reason).items():
        print(f"{name}: laser {pressed.laser}, press {pressed.number}{f'; {pressed.detail}' if pressed.detail else ''}")


@scanner.command("retire", help="Retire a scanner that no longer exists; refused while its node is running.")
def retire(
    context: typer.Context,
    scanner_id: Annotated[str, typer.Argument(metavar="NAME", help="Its name.")],
    abandon: Annotated[bool, typer.Option("--abandon", help="Also give up its scans that are not over.")] = False,
    reason: Reason = None,
) -> None:
    """Decommission a scanner that no longer exists."""
    client_of(context).scanners.retire(scanner_id, abandon=abandon, reason=reason)


@scanner.command("release", help="Release the emergency stop; with its number only that press.")
def release(
    context: typer.Context, number: str | None = None, scanner_id: str = SCANNER, as_json: AsJson = False
) -> None:
    """Release the emergency stop of a scanner."""
    print_item(client_of(context).scanners.release_emergency_stop(number, scanner_id=scanner_id), as_json)


@scanner.command("show", help="Show a scanner: connection, laser, shutter, interlock, key, fault, and how old that is.")
def show_scanner(context: typer.Context, scanner_id: str = SCANNER, as_json: AsJson = False) -> None:
    """Print the state of a scanner."""
    print_item(client_of(context).scanners.get(scanner_id), as_json)


@scanner.command("clear-fault", help="Clear a latched fault, once its cause is gone; the laser stays off.")
def clear_fault(
    context: typer.Context, reason: Reason = None, scanner_id: str = SCANNER, as_json: AsJson = False
) -> None:
    """Clear a latched fault of a scanner."""
    print_item(client_of(context).scanners.clear_fault(scanner_id, reason=reason), as_json)
