"""Creation and saving of matplotlib figures in the common style.

Nothing global is changed: pages may be drawn in several threads at once.
"""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.atomic_files import atomic_write
from steradian.core.exceptions import InvalidInput
from steradian.drawing.style import (
    BACKGROUND,
    BAR_SHARE,
    BAR_START,
    FONT,
    FOREGROUND,
    LABEL,
    LEAST,
    PLAIN,
    SECONDARY,
    TICK,
    TITLE,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

RESOLUTION = 120
PICTURES = (".png", ".pdf", ".svg")
"""Endings of the names of pictures."""


def page(width: int, shape: float, least: int = LEAST) -> Figure:
    """Return an empty figure ``width`` pixels wide and ``shape`` times as high.

    Below ``least`` pixels everything on it shrinks. Its plots get the room that their labels need when it is drawn.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    inches = max(width, least) / RESOLUTION
    dpi = width / inches
    figure = Figure(figsize=(inches, shape * inches), dpi=dpi, layout="constrained")
    figure.set_facecolor(BACKGROUND)
    FigureCanvasAgg(figure)
    layout: Any = figure.get_layout_engine()
    layout.set(w_pad=0.12, h_pad=0.12, wspace=0.03, hspace=0.03)
    return figure


def set_title(figure: Figure, title: str) -> None:
    """Set the title of a figure."""
    figure.suptitle(title, fontsize=points(TITLE + 2), color=FOREGROUND, fontfamily=FONT)


def style_axes(axes: Axes, *, title: str = "", across: str = "", up: str = "", equal: bool = False) -> None:
    """Set labels and the common style of matplotlib axes."""
    axes.set_title(
        title, y=1.0, fontsize=points(TITLE), color=FOREGROUND, fontfamily=FONT
    )  # there, without looking for room
    axes.set_xlabel(across, fontsize=points(LABEL), color=FOREGROUND, fontfamily=FONT)
    axes.set_ylabel(up, fontsize=points(LABEL), color=FOREGROUND, fontfamily=FONT)
    axes.tick_params(labelsize=points(TICK), labelcolor=FOREGROUND, color=FOREGROUND, labelfontfamily=FONT)
    for side in axes.spines.values():
        side.set(color=SECONDARY, linewidth=0.8)
    if equal:
        axes.set_aspect("equal")


def colour_bar(axes: Axes, shown: Any, label: str) -> Any:
    """Add a colour bar beside axes, of the same height."""
    place = axes.inset_axes((1 + BAR_START, 0.0, BAR_SHARE, 1.0))
    bar = axes.figure.colorbar(shown, cax=place)
    style_axes(place, up=label)
    return bar


def colour_limits(values: NDArray[np.float64], colour_map: str) -> dict[str, Any]:
    """Return a colour map from minimum to maximum; a range below a thousandth counts as one colour."""
    low, high = float(values.min()), float(values.max())
    margin = 0.05 * high if high - low < 1e-3 * high else 0.0
    return {"cmap": colour_map, "vmin": low - margin, "vmax": high + margin}


def draw_histogram(
    axes: Axes, values: NDArray[np.float64], bins: int, margin: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Draw a histogram of ``bins`` bins from minimum − margin to maximum + margin; return its counts and edges."""
    edges = np.linspace(float(values.min()) - margin, float(values.max()) + margin, bins + 1)
    counts = np.histogram(values, edges)[0].astype(float)
    axes.stairs(counts, edges, fill=True, color=PLAIN)
    return counts, edges


def check_suffix(path: Path, field: str = "file") -> None:
    """Raise ``InvalidInput`` if a file's suffix is not a supported picture format; no suffix means PNG.

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
    """Write a figure into a file by an atomic write; the suffix determines the format.

    Raises
    ------
    InvalidInput
        When it is of no format of pictures.
    """
    check_suffix(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as file:
        figure.savefig(file, format=path.suffix.lstrip(".") or "png")


def to_png(figure: Figure) -> bytes:
    """Return a figure as PNG."""
    file = BytesIO()
    figure.savefig(file, format="png")
    return file.getvalue()


def points(pixels: float) -> float:
    """Convert a length in pixels to matplotlib's unit of text and lines (points)."""
    return pixels * 72 / RESOLUTION
