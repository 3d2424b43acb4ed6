"""How inner loops are compiled: one set of options for the whole package.

Importing this module imports Numba, so only modules that hold kernels import it, and they are imported when first used.

With ``NUMBA_BOUNDSCHECK=1`` in the environment every index is checked, also of the vectors in
:mod:`steradian.imaging.engines.numba.simd`, and a kernel that would read or write outside an array raises
``IndexError``.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

from numba import njit
from numba.core.caching import FunctionCache


def compiled(function: Callable[..., Any], *, fast: bool = True, kept: bool = True) -> Any:
    """Compile a loop at its first call; it then releases the interpreter lock and is kept on disk.

    Numba keeps it beside the source or in the user's cache; where neither can be written (a read-only container, say)
    and ``NUMBA_CACHE_DIR`` names no other place, it is compiled once a process.

    Parameters
    ----------
    function
        Plain Python on arrays and numbers; callees must be compiled too, and come from the same folder: a change to any
        source there compiles it anew.
    fast
        Allow sums to be reordered and assume finite numbers.
    kept
        Keep it on disk; of no use to a function made by another one, whose callers are kept with it inside.
    """
    options: dict[str, Any] = {"nogil": True, "fastmath": fast, "boundscheck": False, "error_model": "numpy"}
    made = njit(**options)(function)
    if kept:
        try:
            made._cache = _Cache(function)  # type: ignore[no-untyped-call]
        except RuntimeError:  # Numba found no place to cache
            pass
    return made


class _Cache(FunctionCache):
    """Numba's cache looks at the function's own file only to see whether it is stale; this one at its whole folder."""

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        folder = Path(self._py_func.__code__.co_filename).parent
        key: tuple[Any, ...] = super()._index_key(sig, codegen)  # type: ignore[no-untyped-call]
        return (*key, _sources(folder), os.environ.get("NUMBA_BOUNDSCHECK"))


@lru_cache
def _sources(folder: Path) -> str:
    """Hash of all Python sources of a folder, and of this one."""
    found = hashlib.sha256()
    for path in (Path(__file__), *sorted(folder.glob("*.py"))):
        found.update(path.read_bytes())
    return found.hexdigest()
