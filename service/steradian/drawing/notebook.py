"""HTML representations for notebooks."""

from __future__ import annotations

import html
from base64 import b64encode
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from steradian.drawing.mpl_style import page, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH = 640
"""Of a picture in a notebook, in pixels."""


def html_card(text: str, draw: Callable[[Path], object]) -> str:
    """Return an HTML card with an object's summary line and a picture, which ``draw`` writes as PNG."""
    with TemporaryDirectory(prefix="steradian-") as folder:
        path = Path(folder) / "picture.png"
        draw(path)
        picture = b64encode(path.read_bytes()).decode()
    line = html.escape(text)
    return f'<div><code>{line}</code><br><img alt="{line}" src="data:image/png;base64,{picture}"></div>'


def html_plot(text: str, plot: Callable[[Axes], object]) -> str:
    """Return an HTML card with an object's summary line and a picture of one plot, which ``plot`` draws into axes."""
    figure = page(WIDTH, 0.8)
    plot(figure.add_subplot())
    return html_card(text, lambda path: save(figure, path))


def resolve_axes(axes: Axes | None) -> Axes:
    """Return the given matplotlib axes, or those of a new figure."""
    if axes is not None:
        return axes
    from matplotlib import pyplot

    return pyplot.figure(layout="constrained").add_subplot()
