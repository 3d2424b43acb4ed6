"""``steradian export``: convert scans and volumes to other formats."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from steradian.cli.console import console, finish_with_summary, progress_bar
from steradian.core.exceptions import InvalidInput
from steradian.reconstructions.exporting import ENDINGS as VOLUME_ENDINGS
from steradian.reconstructions.exporting import FORMATS as VOLUME_FORMATS
from steradian.scans.exporting import ENDINGS as SCAN_ENDINGS
from steradian.scans.exporting import FORMATS as SCAN_FORMATS


def export(
    source: Annotated[
        Path,
        typer.Argument(help="A scan file, or a volume file as 'steradian reconstruct' leaves it.", metavar="SOURCE"),
    ],
    destination: Annotated[Path, typer.Argument(help="The file or folder to write.", metavar="DEST")],
    format: Annotated[
        str | None,
        typer.Option(
            "--format",
            "-f",
            help=f"Format of a volume: {', '.join(VOLUME_FORMATS)}; of a scan: {', '.join(SCAN_FORMATS)}. "
            "Default: from the ending of DEST.",
        ),
    ] = None,
    frame: Annotated[
        int | None, typer.Option(help="Which frame of a scan of several goes into an .sgl file, which holds one.")
    ] = None,
) -> None:
    """Write a scan as IPASC or .sgl, or a volume in a format of other programs.

    NIfTI, TIFF and OME-Zarr need the extra *export* (`pip install 'steradian[export]'`). A file of that name is
    replaced, a folder never.
    """
    from steradian.reconstructions.exporting import export_volume
    from steradian.scans.exporting import export_scan
    from steradian.scans.importing.detect import is_scan_file

    notes: list[str] = []
    with progress_bar() as progress:
        if is_scan_file(source):
            chosen = format or _of_scan(destination)
            export_scan(
                source,
                destination,
                format=chosen,
                frame=frame,
                notes=notes,
                progress=progress,
            )
        else:
            chosen = format or _by_ending(destination)
            export_volume(source, destination, format=chosen, progress=progress)
    for note in notes:
        console().print(f"note: {note}", markup=False)
    finish_with_summary((f"{source} as {chosen}", destination))


def _of_scan(path: Path) -> str:
    if (found := SCAN_ENDINGS.get(path.suffix.lower())) is None:
        allowed = f"a name that ends in {', '.join(SCAN_ENDINGS)}; or -f {'|'.join(SCAN_FORMATS)}"
        raise InvalidInput("destination", path.name, allowed)
    return found


def _by_ending(path: Path) -> str:
    if (found := VOLUME_ENDINGS.get(path.suffix.lower())) is None:
        allowed = f"-f {'|'.join(VOLUME_FORMATS)}, or a name that ends in {', '.join(VOLUME_ENDINGS)}"
        raise InvalidInput("format", f"missing (the name {path.name} has no known ending)", allowed)
    return found
