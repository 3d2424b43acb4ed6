"""Lazy imports of the modules that display, plot and save masks, scans and volumes in notebooks."""

TYPE_CHECKING = False  # not typing's: this module is part of the package's start
if TYPE_CHECKING:
    from collections.abc import Callable

display_loaders: "list[Callable[[], None]]" = []
