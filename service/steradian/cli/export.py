"""``steradian export``: convert scans and volumes to other formats."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from steradian.cli.console import console, finish_with_summary, progress_bar
from steradian.core.exceptions import InvalidInput


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
            help="Of a volume: hdf5, nifti, tiff, ome-zarr, vtkhdf, nrrd or png; of a scan: ipasc or sgl. "
            "Default: as the name ends.",
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
                format=chosen,  # type: ignore[arg-type]
                frame=frame,
                notes=notes,
                progress=progress,
            )
        else:
            chosen = format or _by_ending(destination)
            export_volume(source, destination, format=chosen, progress=progress)  # type: ignore[arg-type]
    for note in notes:
        console().print(f"note: {note}", markup=False)
    finish_with_summary((f"{source} as {chosen}", destination))


def _of_scan(path: Path) -> str:
    from steradian.scans.exporting import ENDINGS

    found = ENDINGS.get(path.suffix.lower())
    if found is None:
        allowed = f"a name that ends in {', '.join(ENDINGS)}; or -f {'|'.join(dict.fromkeys(ENDINGS.values()))}"
        raise InvalidInput("destination", path.name, allowed)
    return found


def _by_ending(path: Path) -> str:
    from steradian.reconstructions.exporting import ENDINGS

    found = ENDINGS.get(path.suffix.lower())
    if found is None:
        allowed = f"-f {'|'.join(dict.fromkeys(ENDINGS.values()))}, or a name that ends in {', '.join(ENDINGS)}"
        raise InvalidInput("format", f"missing (the name {path.name} tells none)", allowed)
    return found
