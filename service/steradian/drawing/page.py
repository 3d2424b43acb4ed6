"""Pages of plots: matplotlib figures in the style of all pictures.

Nothing global is changed: pages may be drawn in several threads at once.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

from steradian.drafts import draft
from steradian.drawing.style import FONT, INK, LABEL, PAPER, QUIET, TICK, TITLE
from steradian.errors import InvalidInput

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

RESOLUTION = 120
PICTURES = (".png", ".pdf", ".svg")
"""Endings of the names of pictures."""
LEAST = 1100
"""Narrower pages are this wide and shrunk, letters and all."""
HEAD, ABOVE, BELOW, BEFORE, BEHIND = 40, 34, 58, 84, 84
"""Pixels for a page's title, and around each of its :func:`panels`, whose bar of colours comes before the last."""
BAR_START, BAR_END = 0.03, 0.075
"""From where to where a bar of colours reaches beyond its plot, as shares of the plot's width."""


def page(width: int, shape: float, least: int = LEAST, *, laid_out: bool = True) -> Figure:
    """Return an empty figure ``width`` pixels wide and ``shape`` times as high.

    Below ``least`` pixels everything on it shrinks. Unless ``laid_out`` is False, its plots get the room that their
    labels need when it is drawn; measuring these costs more than drawing all of it, so pages whose labels are known
    have :func:`panels`.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    inches = max(width, least) / RESOLUTION
    dpi = width / inches
    figure = Figure(figsize=(inches, shape * inches), dpi=dpi, layout="constrained" if laid_out else None)
    figure.set_facecolor(PAPER)
    FigureCanvasAgg(figure)
    layout: Any = figure.get_layout_engine()
    if layout is not None:
        layout.set(w_pad=0.12, h_pad=0.12, wspace=0.03, hspace=0.03)
    return figure


def panels(figure: Figure, rows: int, columns: int) -> Any:
    """Return (rows, columns) plots with room for a title, marks of four digits, names and a bar of colours each."""
    across, up = RESOLUTION * figure.get_size_inches()
    wide = (across - columns * (BEFORE + BEHIND)) / (columns * (1 + BAR_END))
    high = (up - HEAD - rows * (ABOVE + BELOW)) / rows
    return figure.subplots(
        rows,
        columns,
        gridspec_kw={
            "left": BEFORE / across,
            "right": 1 - (BEHIND + BAR_END * wide) / across,
            "top": 1 - (HEAD + ABOVE) / up,
            "bottom": BELOW / up,
            "wspace": (BEFORE + BEHIND) / wide + BAR_END,
            "hspace": (ABOVE + BELOW) / high,
        },
    )


def name_page(figure: Figure, title: str) -> None:
    """Write the title of a page."""
    figure.suptitle(title, fontsize=_points(TITLE + 2), color=INK, fontfamily=FONT)


def dress(axes: Axes, *, title: str = "", across: str = "", up: str = "", equal: bool = False) -> None:
    """Give a plot its names and the style of all pictures."""
    axes.set_title(title, y=1.0, fontsize=_points(TITLE), color=INK, fontfamily=FONT)  # there, without looking for room
    axes.set_xlabel(across, fontsize=_points(LABEL), color=INK, fontfamily=FONT)
    axes.set_ylabel(up, fontsize=_points(LABEL), color=INK, fontfamily=FONT)
    axes.tick_params(labelsize=_points(TICK), labelcolor=INK, color=INK, labelfontfamily=FONT)
    for side in axes.spines.values():
        side.set(color=QUIET, linewidth=0.8)
    if equal:
        axes.set_aspect("equal")


def colour_bar(axes: Axes, shown: Any, label: str) -> Any:
    """Put a bar of colours beside a plot, as high as the plot is."""
    place = axes.inset_axes((1 + BAR_START, 0.0, BAR_END - BAR_START, 1.0))
    bar = axes.figure.colorbar(shown, cax=place)
    dress(place, up=label)
    return bar


def note(axes: Axes, x: float, y: float, text: str, **wishes: Any) -> None:
    """Write a remark into a plot, at shares of its width and height."""
    look: dict[str, Any] = {"fontsize": _points(TICK), "color": QUIET, "fontfamily": FONT} | wishes
    axes.text(x, y, text, transform=axes.transAxes, **look)


def check_ending(path: Path, field: str = "file") -> None:
    """Refuse a file whose name's ending is of no format that pages can be written in; none at all means PNG.

    Raises
    ------
    InvalidInput
        Of ``field``, with the endings there are.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    formats = FigureCanvasAgg.get_supported_filetypes()
    if path.suffix and path.suffix.lower().lstrip(".") not in formats:
        raise InvalidInput(field, path.name, "a picture: " + ", ".join(f".{name}" for name in sorted(formats)))


def save(figure: Figure, path: Path) -> None:
    """Write a page into a file, under a temporary name first; the ending of its name decides the format.

    Raises
    ------
    InvalidInput
        When it is of no format of pictures.
    """
    check_ending(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with draft(path) as file:
        figure.savefig(file, format=path.suffix.lstrip(".") or "png")


def png(figure: Figure) -> bytes:
    """Return a page as PNG, without a file."""
    written = io.BytesIO()
    figure.savefig(written, format="png")
    return written.getvalue()


def _points(pixels: float) -> float:
    return pixels * 72 / RESOLUTION
