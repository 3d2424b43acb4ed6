"""Value with notebook display, plot() and save()."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from steradian.core.validation import Value

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class DisplayableValue(Value):
    """A mask or a plan: the same as another one when its identifier is, and known by a line and pictures."""

    if TYPE_CHECKING:

        @property
        def id(self) -> str:
            """Identifier of the content."""

        def _draw(self, axes: Axes) -> object: ...

        def _draw_figure(self, path: Path) -> object: ...

        def _write(self, path: Path) -> object: ...

    def __str__(self) -> str:
        return repr(self)

    def __eq__(self, other: object) -> bool:
        return self.id == other.id if isinstance(other, type(self)) else NotImplemented

    def __hash__(self) -> int:
        return hash(self.id)

    def _repr_html_(self) -> str:
        from steradian.drawing.notebook import html_plot

        return html_plot(repr(self), self.plot)

    def plot(self, axes: Axes | None = None) -> Axes:
        """Plot a mask's sensors, coloured by weight, or the scan path of a plan.

        Parameters
        ----------
        axes
            A matplotlib plot to draw into; None: a new one. :meth:`save` draws a whole page.
        """
        from steradian.drawing.notebook import resolve_axes

        axes = resolve_axes(axes)
        self._draw(axes)
        return axes

    def save(self, path: str | Path) -> None:
        """Write it into a file, or a page of pictures of it, as the ending of its name says.

        ``.json`` keeps everything, of a mask ``.csv`` and ``.npy`` positions and weights; ``.png``, ``.pdf`` and
        ``.svg`` are pictures.

        Raises
        ------
        InvalidInput
            When the ending is another one.
        """
        from steradian.drawing.mpl_figure import PICTURES

        path = Path(path)
        if path.suffix.lower() in PICTURES:
            self._draw_figure(path)
        else:
            self._write(path)
