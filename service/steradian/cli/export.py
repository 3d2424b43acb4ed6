"""``steradian export``: convert scans, volumes and series to other formats."""

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
        typer.Argument(
            help="A scan file, or what 'steradian reconstruct' leaves: volume, series or folder.", metavar="SOURCE"
        ),
    ],
    destination: Annotated[Path | None, typer.Argument(help="The file or folder to write.", metavar="[DEST]")] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="The same, as an option.")] = None,
    format: Annotated[
        str | None,
        typer.Option(
            "--format",
            "-f",
            help=f"Format of a volume: {', '.join(VOLUME_FORMATS)} (a series: the first four); "
            f"of a scan: {', '.join(SCAN_FORMATS)}. Default: from the ending of DEST.",
        ),
    ] = None,
    frame: Annotated[
        int | None, typer.Option(help="Which frame of a scan of several goes into an .sgl file, which holds one.")
    ] = None,
) -> None:
    """Write a scan as IPASC or .sgl, or a volume or series in a format of other programs.

    A series becomes 4-D NIfTI (with a JSON file beside it), an ImageJ hyperstack, OME-Zarr with time and channel, or
    plain HDF5: wavelengths are channels.

    NIfTI, TIFF and OME-Zarr need the extra *export* (`pip install 'steradian[export]'`). A file of that name is
    replaced, a folder never.
    """
    from steradian.reconstructions.exporting import export_volume
    from steradian.reconstructions.exporting.series import export_series
    from steradian.reconstructions.series.file import is_series_file
    from steradian.scans.exporting import export_scan
    from steradian.scans.importing.detect import is_scan_file

    if (destination is None) == (output is None):
        value = "missing" if output is None else f"{destination} and {output}"
        raise InvalidInput("destination", value, "one name of a file to write")
    wanted = destination or output
    assert wanted is not None  # noqa: S101 - one of both is given
    if source.is_dir():
        names = [source / name for name in ("volume.h5", "series.h5") if (source / name).is_file()]
        source = names[0] if names else source
    notes: list[str] = []
    with progress_bar() as progress:
        if is_scan_file(source):
            chosen = format or _of_scan(wanted)
            export_scan(source, wanted, format=chosen, frame=frame, notes=notes, progress=progress)
        elif is_series_file(source):
            chosen = format or _by_ending(wanted)
            export_series(source, wanted, format=chosen, sidecar=True, progress=progress)
        else:
            chosen = format or _by_ending(wanted)
            export_volume(source, wanted, format=chosen, progress=progress)
    for note in notes:
        console().print(f"note: {note}", markup=False)
    finish_with_summary((f"{source} as {chosen}", wanted))


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
