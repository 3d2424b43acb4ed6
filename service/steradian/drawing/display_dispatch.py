"""Single-dispatch functions that display and save values.

The modules that implement them lie above the values; :data:`display_loaders` has functions that import them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import singledispatch
from typing import TYPE_CHECKING, Any

from steradian._display_loaders import display_loaders

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes


@singledispatch
def plot(value: object, axes: Axes | None = None, **options: Any) -> Axes:
    """Plot a value into matplotlib axes; None: new axes. Raises TypeError for unsupported types."""
    axes = _implementation(plot, value)(value, axes, **options)
    return axes


@singledispatch
def save(value: object, path: Path) -> None:
    """Write a value or its picture into a file; the suffix determines the format. Raises TypeError as :func:`plot`."""
    _implementation(save, value)(value, path)


@singledispatch
def figure(value: object, path: Path, **options: Any) -> Path:
    """Write a figure for a paper; the suffix determines the format. Raises TypeError as :func:`plot`."""
    written: Path = _implementation(figure, value)(value, path, **options)
    return written


@singledispatch
def to_html(value: object) -> str:
    """Return an HTML representation of a value for notebooks; raises TypeError as :func:`plot`."""
    html: str = _implementation(to_html, value)(value)
    return html


def _implementation(function: Any, value: object) -> Callable[..., Any]:
    for load in display_loaders:  # kept, because another thread may be in the middle of the imports
        load()
    found: Callable[..., Any] = function.dispatch(type(value))
    if found is function.dispatch(object):
        raise TypeError(f"a {type(value).__name__} has no implementation of {function.__name__}")
    return found
