"""How inner loops are compiled: one set of options for the whole package.

Importing this module imports Numba, so only modules that hold kernels import it, and they are imported when first used.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit


def compiled(function: Callable[..., Any], *, fast: bool = True, kept: bool = True) -> Any:
    """Compile a loop at its first call; it then releases the interpreter lock and is kept on disk.

    Numba keeps it beside the source or in the user's cache; where neither can be written (a read-only container, say)
    and ``NUMBA_CACHE_DIR`` names no other place, it is compiled once a process.

    Parameters
    ----------
    function
        Plain Python on arrays and numbers; callees must be compiled too. After a change to a callee in another file,
        touch the files that call it: Numba looks only at the caller's own file to see whether its cache is stale.
    fast
        Allow sums to be reordered and assume finite numbers.
    kept
        Keep it on disk; of no use to a function made by another one, whose callers are kept with it inside.
    """
    options: dict[str, Any] = {"nogil": True, "fastmath": fast, "boundscheck": False, "error_model": "numpy"}
    try:
        return njit(cache=kept, **options)(function)
    except RuntimeError:  # Numba found no place to cache
        return njit(**options)(function)
