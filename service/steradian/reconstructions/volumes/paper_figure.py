"""Figures for papers: panels side by side with one colour scale, in PDF, SVG or PNG of a stated size."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from steradian.core.atomic_files import atomic_write
from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import as_finite_float
from steradian.drawing.style import FONT, depth_colours
from steradian.reconstructions.volumes.overlay import Overlay
from steradian.reconstructions.volumes.panels import ColourScale, Panel, colour_table
from steradian.reconstructions.volumes.scale_bar import draw_scale_bar

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ENDINGS = (".pdf", ".svg", ".png")
MM = 1 / 25.4
"""Inches a millimetre."""
LEFT, RIGHT, BELOW, ABOVE, BETWEEN = 11.0, 17.5, 9.0, 2.0, 3.0
"""Margins of the page and the gap between panels in mm; the colour bar is in the right one."""
LINE = 3.2
"""Height of a line of letters in mm."""
LETTER = 1.3
"""Mean width of a letter in mm."""
NARROWEST = 8.0
"""Least width of a panel in mm."""
MAX_HEIGHT = 1000.0
"""Largest height of a page in mm."""
MAX_PIXELS = 2**27
"""Largest number of pixels of a PNG, which takes 0.5 GB."""
BAR = 3.0
"""Width of the colour bar in mm."""
POINTS = 7.0
"""Usual size of letters in points; margins are for it, and grow with larger letters."""
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class FigureSize:
    """Size of a figure.

    Parameters
    ----------
    width
        Width of the page in mm, 30 to 1000; its height follows from the panels.
    dpi
        Pixels an inch of a PNG, 50 to 2400.
    columns
        Most panels side by side; None: up to 4.
    scale_bar
        Length of the scale bar in mm; None: a round one; 0: none.
    font_size
        Size of letters in points, 4 to 24.
    interpolation
        ``nearest`` or ``linear`` between voxels.

    Raises
    ------
    InvalidInput
        If a value is out of range.
    """

    width: float = 85.0
    dpi: float = 300.0
    columns: int | None = None
    scale_bar: float | None = None
    font_size: float = POINTS
    interpolation: Literal["nearest", "linear"] = "nearest"

    def __post_init__(self) -> None:
        for name, low, high, unit in (("width", 30, 1000, " mm"), ("dpi", 50, 2400, ""), ("font_size", 4, 24, " pt")):
            allowed = f"{low} to {high}{unit}"
            if not low <= as_finite_float(name, getattr(self, name), allowed) <= high:
                raise InvalidInput(name, getattr(self, name), allowed)
        if self.columns is not None and not (self.columns == int(self.columns) and 1 <= self.columns <= 12):
            raise InvalidInput("columns", self.columns, "a whole number from 1 to 12")
        if self.interpolation not in ("nearest", "linear"):
            raise InvalidInput("interpolation", self.interpolation, "nearest, linear")
        if self.scale_bar is not None and not 0 <= as_finite_float("scale_bar", self.scale_bar, "0 to 1000 mm") <= 1000:
            raise InvalidInput("scale_bar", self.scale_bar, "0 to 1000 mm")


def write_figure(
    panels: Sequence[Panel],
    scale: ColourScale,
    path: Path,
    size: FigureSize = FigureSize(),
    overlay: Overlay | None = None,
) -> Path:
    """Write panels with vector axes, scale bar and one colour bar to a PDF, SVG or PNG file (atomic write).

    Images are embedded with one pixel for each voxel, or interpolated at the resolution. Letters of a PDF are
    TrueType, as journals ask for. An overlay is added to each panel and has a colour bar of its own.

    Raises
    ------
    InvalidInput
        When the ending is another one, the page is too narrow for the panels, or it would be too high.
    """
    import matplotlib as mpl

    if path.suffix.lower() not in ENDINGS:
        raise InvalidInput("file", path.name, f"a name in {', '.join(ENDINGS)}")
    figure = _drawn(panels, scale, size, overlay)
    path.parent.mkdir(parents=True, exist_ok=True)
    kind = path.suffix.lower().lstrip(".")
    # the date is left out, so that the same figure is the same file
    metadata = {"pdf": {"CreationDate": None}, "svg": {"Date": None}, "png": {}}[kind]
    with atomic_write(path) as beside, mpl.rc_context({"pdf.fonttype": 42, "svg.hashsalt": "steradian"}):
        figure.savefig(beside, format=kind, dpi=size.dpi, metadata=metadata)
    return path


def _drawn(panels: Sequence[Panel], scale: ColourScale, size: FigureSize, overlay: Overlay | None) -> Figure:
    """Lay out and draw: panels of a row lie side by side, all at one scale of length."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = min(len(panels), size.columns or 4)
    rows = [panels[n : n + columns] for n in range(0, len(panels), columns)]
    left, right, below, line = (each * size.font_size / POINTS for each in (LEFT, RIGHT, BELOW, LINE))
    bars = [scale] if overlay is None else [scale, overlay.scale]
    gaps = [_gaps(row, left) for row in rows]
    rooms = [size.width - left - len(bars) * right - sum(gap) for gap in gaps]
    scales = [room / sum(map(_width, row)) for room, row in zip(rooms, rows, strict=True) if room > 0]
    pitch = min(scales) if len(scales) == len(rows) else 0.0  # mm on paper for each mm of the image
    if pitch * min(map(_width, panels)) < NARROWEST:
        allowed = f"at most what leaves panels {NARROWEST:g} mm wide on {size.width:g} mm"
        raise InvalidInput("columns", columns, allowed)
    names = [[_wrapped(each.name, pitch * _width(each), size) for each in row] for row in rows]
    headings = [max(line * len(each) + 0.8 if each else 0.0 for each in row) for row in names]
    heights = [pitch * max(map(_height, row)) for row in rows]
    feet = [below if _has_labels(rows, n) else BETWEEN for n in range(len(rows))]
    height = ABOVE + sum(headings) + sum(heights) + sum(feet)
    longest = max(len(_bar_label(each)[1]) for each in bars)
    height = max(height, 2 * ABOVE + LETTER * size.font_size / POINTS * (longest / 2 + 4))  # the label in two lines
    most = min(MAX_HEIGHT, MAX_PIXELS / (size.width * (size.dpi * MM) ** 2))
    if height > most:
        allowed = f"what makes the page at most {most:.0f} mm high at this width and dpi"
        raise InvalidInput("region", f"panels that make it {height:.0f} mm high", allowed)
    figure = Figure(figsize=(size.width * MM, height * MM), dpi=size.dpi)
    FigureCanvasAgg(figure)
    letters: dict[str, Any] = {"fontsize": size.font_size, "fontfamily": FONT}
    top, edge = height - ABOVE, 0.0
    for number, row in enumerate(rows):
        top, x, before = top - headings[number], left, 0.0
        for panel, gap, name in zip(row, [*gaps[number], 0.0], names[number], strict=True):
            wide, high = pitch * _width(panel), pitch * _height(panel)
            axes = figure.add_axes((x / size.width, (top - high) / height, wide / size.width, high / height))
            colours = scale.paint(panel)
            _put_panel(axes, panel, colours if overlay is None else overlay.paint(panel, colours), size)
            axes.set_title("\n".join(name), pad=2, parse_math=False, **letters)
            has_x = _has_labels(rows, number) or (panel is not row[0] and _height(panel) < max(map(_height, row)))
            has_y = panel is row[0] or before > BETWEEN
            axes.tick_params(labelbottom=has_x, labelleft=has_y)
            axes.set_xlabel(panel.labels[0] if has_x else "", labelpad=1, **letters)
            axes.set_ylabel(_fitting(panel.labels[1], high, size) if has_y else "", labelpad=1, **letters)
            x, before, edge = x + wide + gap, gap, max(edge, x + wide)
        top -= heights[number] + feet[number]
    tall = min(height - ABOVE - headings[0] - feet[-1], 40.0)
    lower = (height - ABOVE - headings[0] - tall) / height
    for number, each in enumerate(bars):
        x = edge + 2.0 + number * right
        axes = figure.add_axes((x / size.width, lower, BAR / size.width, tall / height))
        _put_bar(axes, each, size, height)
    return figure


def _fitting(label: str, height: float, size: FigureSize) -> str:
    """Return the label of an upright axis, without its explanation if it is longer than the panel is high in mm."""
    length = LETTER * size.font_size / POINTS * len(label)
    return label if length <= height + 2 * ABOVE else f"{label[0]} (mm)"


def _width(panel: Panel) -> float:
    """Return the width of a panel in mm of the image."""
    return abs(panel.across[1] - panel.across[0])


def _height(panel: Panel) -> float:
    """Return the height of a panel in mm of the image."""
    return abs(panel.up[1] - panel.up[0])


def _gaps(row: Sequence[Panel], labelled: float) -> list[float]:
    """Return the gaps in mm between panels of a row: narrow where the axis upwards is that of the panel before."""
    same = [(one.up, one.labels[1]) == (other.up, other.labels[1]) for one, other in pairwise(row)]
    return [BETWEEN if each else labelled for each in same]


def _has_labels(rows: Sequence[Sequence[Panel]], number: int) -> bool:
    """Return whether a row has labels at its lower edge: the last, or where another axis or no panel is below."""
    if number == len(rows) - 1:
        return True
    row, lower = rows[number], rows[number + 1]
    above, below = [[(each.across, each.labels[0]) for each in line] for line in (row, lower)]
    return above[: len(below)] != below or len(below) < len(above)


def _wrapped(text: str, width: float, size: FigureSize, at_commas: bool = True) -> list[str]:
    """Return a text in lines that fit a width in mm, broken after commas if asked and it has some, else at spaces.

    What stands in brackets, such as a unit, stays together.
    """
    lines: list[str] = []
    parts = text.split(", ")
    letter = LETTER * size.font_size / POINTS
    words = re.findall(r"\([^)]*\)|\S+", text)
    if at_commas and len(parts) > 1:
        words = [*(f"{part}," for part in parts[:-1]), parts[-1]]
    for word in words:
        if lines and letter * (len(lines[-1]) + 1 + len(word)) <= width:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    return lines


def _put_panel(axes: Axes, panel: Panel, colours: NDArray[np.uint8], size: FigureSize) -> None:
    extent, scale_bar = (*panel.across, *panel.up), size.scale_bar
    way = "bilinear" if size.interpolation == "linear" else "none"
    axes.imshow(colours, origin="lower", extent=extent, interpolation=way, aspect="equal", zorder=0)
    axes.tick_params(labelsize=size.font_size, width=0.5, length=2, pad=1.5, labelfontfamily=FONT)
    for side in axes.spines.values():
        side.set_linewidth(0.5)
    if scale_bar != 0:
        draw_scale_bar(axes, panel.across, panel.up, scale_bar, size.font_size)


def _put_bar(axes: Axes, scale: ColourScale, size: FigureSize, height: float) -> None:
    """Draw the colour bar on a page ``height`` mm high: of the values, or of the depths of their maxima.

    Its label is in the middle of the page, which has room for it.
    """
    from matplotlib.ticker import MaxNLocator

    power, label = _bar_label(scale)
    if scale.depth_span is None:
        share = scale.share(np.linspace(scale.lowest, scale.highest, 256))
        colours = colour_table(scale.colour_map)[np.round(255 * share).astype(np.uint8)]
        first, last = scale.lowest / 10.0**power, scale.highest / 10.0**power
    else:
        colours, (first, last) = depth_colours()[::-1] / 255, scale.depth_span[::-1]
    axes.imshow(colours[:, None], origin="lower", extent=(0, 1, first, last), aspect="auto", interpolation="none")
    axes.set_xticks([])
    axes.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    axes.yaxis.tick_right()
    axes.yaxis.set_label_position("right")
    text = "\n".join(_wrapped(label, height - 2 * ABOVE, size, at_commas=False))
    lower, upper = axes.get_position().y0, axes.get_position().y1
    axes.set_ylabel(
        text, y=(0.5 - lower) / (upper - lower), fontsize=size.font_size, labelpad=2, fontfamily=FONT, parse_math=False
    )
    axes.tick_params(labelsize=size.font_size, width=0.5, length=2, pad=1.5, labelfontfamily=FONT)
    for side in axes.spines.values():
        side.set_linewidth(0.5)


def _bar_label(scale: ColourScale) -> tuple[int, str]:
    """Return the power of ten that ticks are divided by, and the label with it."""
    if scale.depth_span is not None:
        return 0, "z, depth of the maximum (mm)"
    power = int(np.floor(np.log10(max(abs(scale.lowest), abs(scale.highest)))))
    if -2 < power < 4:
        return 0, scale.label
    factor = "10" + str(power).translate(SUPERSCRIPTS)
    before, bracket, after = scale.label.rpartition("(")
    return power, f"{before}({factor} {after}" if bracket else f"{scale.label} ({factor})"
