"""Notebook display, plotting and saving of volumes."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from steradian.drawing import display_dispatch
from steradian.drawing.mpl_style import colour_bar, style_axes
from steradian.drawing.notebook import WIDTH, html_card, resolve_axes
from steradian.imaging import Display, Volume
from steradian.reconstructions.exporting import export_volume, format_of
from steradian.reconstructions.volumes.file import write_volume
from steradian.reconstructions.volumes.images import PLANE_LABELS, Axis, display_range, draw_mip, extent_mm
from steradian.reconstructions.volumes.projections import project

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@display_dispatch.to_html.register(Volume)
def render_html(volume: Volume) -> str:
    """Return an HTML summary of a volume with its projection along z, for a notebook."""
    axis: Axis = "z" if volume.dimensions == 3 else "y"
    return html_card(repr(volume), lambda path: draw_mip(volume, axis, path, Display(size=WIDTH)))


@display_dispatch.plot.register(Volume)
def plot_volume(volume: Volume, axes: Axes | None = None, axis: Axis = "z") -> Axes:
    """Plot a projection of a volume with matplotlib; implements :meth:`steradian.Volume.plot`."""
    if volume.dimensions == 2:
        axis = "y"
    else:
        volume.coordinates(axis)  # refuses any other
    across, up = PLANE_LABELS[axis]
    options, image = Display(), project(volume)[axis]
    lowest, highest, ending = display_range(image, options)
    (left, right), (first, last) = extent_mm(volume, across), extent_mm(volume, up)
    ends = (first, last) if up == "y" else (last, first)  # depth points down
    axes = resolve_axes(axes)
    shown = axes.imshow(
        image.T if up == "y" else image.T[::-1],
        origin="lower",
        extent=(left, right, *ends),
        cmap=options.colour_map,
        vmin=lowest,
        vmax=highest,
    )
    colour_bar(axes, shown, "initial pressure (arb. u.)")
    name = f"Maximum-intensity projection along {axis}" if volume.dimensions == 3 else "Image below the line"
    title = f"{name}, {ending}" if ending else name
    style_axes(
        axes, title=title, across=f"{across} (mm)", up=f"{up} (mm)" if up == "y" else "z, depth (mm)", equal=True
    )
    return axes


@display_dispatch.save.register(Volume)
def save_volume(volume: Volume, path: Path) -> None:
    """Write a volume in the format of the file name's ending; implements :meth:`steradian.Volume.save`."""
    wanted = format_of(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    if wanted == "hdf5":
        write_volume(path, volume, parameters={}, provenance={})
        return
    with TemporaryDirectory(prefix=".steradian-", dir=path.parent) as folder:
        whole = Path(folder) / "volume.h5"
        write_volume(whole, volume, parameters={}, provenance={})
        export_volume(whole, path, format=wanted)
