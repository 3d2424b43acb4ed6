"""Notebook display, plotting and saving of volumes and series."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from steradian.core.exceptions import InvalidInput
from steradian.drawing import display_dispatch
from steradian.drawing.mpl_style import colour_bar, points, style_axes
from steradian.drawing.notebook import WIDTH, html_card, resolve_axes
from steradian.drawing.style import LABEL, TICK
from steradian.imaging import Display, Volume
from steradian.reconstructions.exporting import export_volume, format_of
from steradian.reconstructions.exporting.series import export_series
from steradian.reconstructions.series.file import SeriesWriter
from steradian.reconstructions.series.film import MOST_FRAMES, write_film
from steradian.reconstructions.series.frames import SeriesFrame
from steradian.reconstructions.series.series import Series
from steradian.reconstructions.volumes.file import write_volume
from steradian.reconstructions.volumes.images import PLANE_LABELS, Axis, display_range, draw_mip, extent_mm
from steradian.reconstructions.volumes.overlay import Overlay
from steradian.reconstructions.volumes.panels import ColourScale, OutsideVolume, Panel, colour_table
from steradian.reconstructions.volumes.paper_figure import FigureSize, write_figure
from steradian.reconstructions.volumes.projections import project
from steradian.reconstructions.volumes.scale_bar import draw_scale_bar

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@display_dispatch.to_html.register(Volume)
def render_html(volume: Volume) -> str:
    """Return an HTML summary of a volume with its projection along z, for a notebook."""
    axis: Axis = "z" if volume.dimensions == 3 else "y"
    return html_card(repr(volume), lambda path: draw_mip(volume, axis, path, Display(size=WIDTH)))


BESIDE_BAR = 0.7
"""Share of the width of axes without a layout engine that is left beside a colour bar with labels."""


@display_dispatch.plot.register(Volume)
def plot_volume(
    volume: Volume,
    axes: Axes | None = None,
    axis: Axis = "z",
    *,
    cmap: str = Display().colour_map,
    vmin: float | None = None,
    vmax: float | None = None,
    scale_bar: float | bool = False,
) -> Axes:
    """Plot a projection of a volume with matplotlib; implements :meth:`steradian.Volume.plot`."""
    from matplotlib.colors import ListedColormap

    if volume.dimensions == 2:
        axis = "y"
    else:
        volume.coordinates(axis)  # refuses any other
    across, up = PLANE_LABELS[axis]
    image = project(volume)[axis]
    lowest, highest, ending = display_range(image, Display())
    lowest, highest = lowest if vmin is None else vmin, highest if vmax is None else vmax
    if not lowest < highest:
        raise InvalidInput("vmax", highest, f"above vmin, {lowest:g}")
    (left, right), (first, last) = extent_mm(volume, across), extent_mm(volume, up)
    ends = (first, last) if up == "y" else (last, first)  # depth points down
    axes = resolve_axes(axes)
    shown = axes.imshow(
        image.T if up == "y" else image.T[::-1],
        origin="lower",
        extent=(left, right, *ends),
        cmap=ListedColormap(colour_table(cmap)),
        vmin=lowest,
        vmax=highest,
    )
    if axes.figure.get_layout_engine() is None:  # else the layout makes room for the colour bar
        left_edge, lower, wide, high = axes.get_position(original=True).bounds
        axes.set_position((left_edge, lower, BESIDE_BAR * wide, high))
    note = f"\n{ending}" if ending and vmax is None else ""
    bar = colour_bar(axes, shown, f"initial pressure (arb. u.){note}")
    bar.formatter.set_powerlimits((-2, 4))
    bar.ax.yaxis.get_offset_text().set_fontsize(points(TICK))
    if scale_bar:
        draw_scale_bar(axes, (left, right), ends, None if scale_bar is True else float(scale_bar), points(LABEL))
    title = f"Maximum along {axis}" if volume.dimensions == 3 else "Image below the line"
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


@display_dispatch.save.register(Series)
def save_series(series: Series, path: Path) -> None:
    """Write a series in the format of the file name's ending; implements :meth:`.Series.save`."""
    wanted = format_of(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    if wanted == "hdf5":
        _write(series, path)
        return
    with TemporaryDirectory(prefix=".steradian-", dir=path.parent) as folder:
        whole = Path(folder) / "series.h5"
        _write(series, whole)
        export_series(whole, path, format=wanted)


def _write(series: Series, path: Path) -> None:
    speed = series[0].sound_speed
    with SeriesWriter(path, parameters={} if speed is None else {"sound_speed": speed}, provenance={}) as writer:
        for frame, volume in zip(series.frames, series, strict=True):
            writer.add(frame, volume)


SCALE = ("limits", "percentile", "label", "colour_map", "depth_coded", "gamma", "log_range_db")
SIZE = ("width", "dpi", "columns", "scale_bar", "font_size", "interpolation")
VIEW = ("axis", "near_field", "slab", "region")


@display_dispatch.figure.register(Volume)
def draw_volume_figure(volume: Volume, path: Path, **options: Any) -> Path:
    """Write a figure of a volume; implements :meth:`steradian.Volume.figure`."""
    name = options.pop("name", "")
    return draw_volumes([(volume, name)], path, **options)


@display_dispatch.figure.register(Series)
def draw_series_figure(series: Series, path: Path, **options: Any) -> Path:
    """Write a figure or film of a series; implements :meth:`.Series.figure` and :meth:`.Series.film`."""
    names = ((volume, frame_name(frame)) for frame, volume in zip(series.frames, series, strict=True))
    return draw_volumes(names, path, **options)


def draw_volumes(
    volumes: Iterable[tuple[Volume, str]],
    path: Path,
    *,
    film: bool = False,
    overlay: Volume | None = None,
    overlay_options: dict[str, Any] | None = None,
    **options: Any,
) -> Path:
    """Write a figure of volumes side by side with one colour scale, or a film; one volume is in memory at a time.

    Parameters
    ----------
    volumes
        With the name of each.
    path
        File to write.
    film
        Whether it is a film (``.gif``).
    overlay
        A volume whose colours are added to those of each, in a figure; None: none.
    overlay_options
        Its ``colour_map`` ("cyan"), ``limits``, ``percentile`` and ``label``, and ``opacity``, the shares of both.
    **options
        As of :meth:`steradian.Volume.figure`, with ``columns``; of a film as of :meth:`.Series.film`.

    Raises
    ------
    InvalidInput
        When the ending is another one, an option is unknown or out of range.
    """
    known = (*VIEW, *(("interval", "size", *SCALE) if film else (*SCALE, *SIZE)))
    for option in options:
        if option not in known:
            raise InvalidInput(option, options[option], f"one of {', '.join(known)}")
    panels = [panel for volume, name in volumes for panel in _panels(volume, name, options)]
    colours = {name: options[name] for name in SCALE if name in options}
    if film:
        shown = {name: options[name] for name in ("interval", "size") if name in options}
        return write_film(panels, ColourScale.of(panels, most=MOST_FRAMES, **colours), path, **shown)
    size = FigureSize(**{name: options[name] for name in SIZE if name in options})
    laid = None if overlay is None else _overlay(overlay, options, overlay_options or {})
    return write_figure(panels, ColourScale.of(panels, **colours), path, size, laid)


def _overlay(volume: Volume, options: dict[str, Any], own: dict[str, Any]) -> Overlay:
    """Return the overlay of a volume, of the same slabs and region; gamma and logarithm are those of the figure."""
    shared: dict[str, Any] = {name: options[name] for name in ("gamma", "log_range_db") if name in options}
    chosen: dict[str, Any] = {"colour_map": "cyan", **shared, **{name: own[name] for name in SCALE if name in own}}
    panels = []
    for axis in _axes(volume, options):
        with suppress(OutsideVolume):
            panels.append(_panel(volume, axis, "", options))
    if not panels:
        raise InvalidInput("overlay", "a volume outside of all panels", "one that reaches the slices and region shown")
    by_labels = {panel.labels: panel for panel in panels}
    return Overlay(by_labels, ColourScale.of(panels, **chosen), tuple(own.get("opacity", (1.0, 1.0))))


def _panels(volume: Volume, name: str, options: dict[str, Any]) -> list[Panel]:
    """Return a panel for each axis of the options."""
    return [_panel(volume, axis, name, options) for axis in _axes(volume, options)]


def _axes(volume: Volume, options: dict[str, Any]) -> tuple[Any, ...]:
    chosen = options.get("axis", "z")
    axes: tuple[Any, ...] = (chosen,) if isinstance(chosen, str) else tuple(chosen)
    return axes if volume.dimensions == 3 else axes[:1]


def _panel(volume: Volume, axis: Any, name: str, options: dict[str, Any]) -> Panel:
    slabs = options.get("slab")
    slab = slabs.get(axis) if isinstance(slabs, dict) else slabs
    shown = {"near_field": options.get("near_field", 0.0), "slab": slab, "region": options.get("region")}
    return Panel.of(volume, axis, name, **shown)


def frame_name(frame: SeriesFrame) -> str:
    """Return the name of a frame in figures: its wavelength, number and time."""
    return str(frame) if frame.time is None else f"{frame}, {frame.time:.4g} s"
