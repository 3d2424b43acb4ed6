"""Functions that import the implementations of :mod:`steradian.drawing.display`; ``steradian/__init__`` adds them."""

TYPE_CHECKING = False  # not typing's: this module is part of the package's start
if TYPE_CHECKING:
    from collections.abc import Callable

display_loaders: "list[Callable[[], None]]" = []
