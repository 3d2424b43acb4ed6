"""Base class of values with a notebook representation, plot() and save()."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from steradian.core.validation import Value
from steradian.drawing import display_dispatch

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class DisplayableValue(Value):
    """Base class of masks and plans: equality by identifier, text, plot and files."""

    if TYPE_CHECKING:

        @property
        def id(self) -> str:
            """Identifier of the content (hash)."""

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
        return display_dispatch.plot(self, axes)

    def save(self, path: str | Path) -> None:
        """Write the value or its summary figure into a file; the suffix determines the format.

        ``.json`` keeps everything, of a mask ``.csv`` and ``.npy`` positions and weights; ``.png``, ``.pdf`` and
        ``.svg`` are pictures.

        Raises
        ------
        InvalidInput
            When the ending is another one.
        """
        display_dispatch.save(self, Path(path))
