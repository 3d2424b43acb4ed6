"""Decorators for Numba compilation with an on-disk cache of compiled functions.

Importing this module imports Numba, so only modules that hold kernels import it, and they are imported when first used.

With ``NUMBA_BOUNDSCHECK=1`` in the environment every index is checked, also of the vectors in
:mod:`steradian.imaging.engines.numba.simd`, and a kernel that would read or write outside an array raises
``IndexError``.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache, partial
from glob import escape
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout
from numba import njit
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.registry import CPUDispatcher

PATIENCE = 120.0
"""Seconds that a process waits for another one to compile a function, before it does so itself."""


def jit(function: Callable[..., Any], *, fast: bool = True, kept: bool = True, inner: bool = False) -> Any:
    """Compile a function with Numba at its first call, without the GIL and cached on disk.

    Of several processes that need it at the same time one compiles it, and the others wait and load what it kept.

    Numba keeps it beside the source or in the user's cache; where neither can be written (a read-only container, say)
    and ``NUMBA_CACHE_DIR`` names no other place, it is compiled once a process. What lies beside the source is found
    also where ``NUMBA_CACHE_DIR`` names another place, so that an image can bring it along.

    Parameters
    ----------
    function
        Plain Python on arrays and numbers; callees must be compiled too, and come from the same folder: a change to any
        source there compiles it anew.
    fast
        Allow sums to be reordered and assume finite numbers.
    kept
        Keep it on disk; of no use to a function made by another one, whose callers are kept with it inside.
    inner
        Only compiled functions call it: it gets no entrance for Python, which takes as long to compile as a short loop.
    """
    options: dict[str, Any] = {"nogil": True, "fastmath": fast, "boundscheck": False, "error_model": "numpy"}
    options |= {"no_cfunc_wrapper": True, "no_cpython_wrapper": inner}
    made: Any = njit(**options)(function)
    if inner and isinstance(made, CPUDispatcher):  # not where Numba is told to compile nothing
        made.__class__ = _Inner
    if kept:
        try:
            made._cache = _Cache(function)
        except RuntimeError:  # Numba found no place to cache
            pass
    return made


jit_inline: Any = partial(jit, inner=True)


def is_uncached(function: Any, numbers: str = "float32") -> bool:
    """Return whether Numba's on-disk cache lacks a function for this processor and these argument types."""
    cache = getattr(function, "_cache", None)
    return isinstance(cache, _Cache) and not cache.has_entry(numbers, function.targetctx.codegen())


def cache_lock(function: Any, name: str) -> FileLock:
    """Return a non-blocking file lock in the cache folder of a function."""
    function._cache._impl.locator.ensure_cache_path()
    return FileLock(Path(function._cache.cache_path) / f"{name}.lock", timeout=0)


class _Inner(CPUDispatcher):
    """Numba function that only compiled functions may call; a call from Python raises TypeError."""

    def __call__(self, *_: Any, **__: Any) -> Any:
        raise TypeError(f"{self.py_func.__name__} is called by compiled functions only")


class _Cache(FunctionCache):
    """Numba's on-disk cache, invalidated by changes to any file in the function's folder, with a lock per function.

    Numba itself looks at the function's own file only, and every process that misses a function compiles it: seconds,
    times the workers of a service; of two that keep forms of one function at once, one is lost.
    """

    _turn: FileLock | None = None

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        beside = Path(function.__code__.co_filename).parent / "__pycache__"
        self._brought = IndexDataCacheFile(  # type: ignore[no-untyped-call]
            str(beside), self._impl.filename_base, self._impl.locator.get_source_stamp()
        )

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        found = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        if found is None:
            self._take_turn()
            found = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
            if found is not None:
                self._end_turn()
        return found

    def _load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load a compiled function from the cache, or else from ``__pycache__`` beside the source."""
        found = super()._load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        if found is None and self._enabled:
            found = self._brought.load(self._index_key(sig, target_context.codegen()))  # type: ignore[no-untyped-call]
            found = None if found is None else self._impl.rebuild(target_context, found)
        return found

    def has_entry(self, numbers: str, codegen: Any) -> bool:
        """Return whether the cache has a compiled function for these argument types."""
        wanted = self._index_key(None, codegen)[1:]
        keys = (key for file in (self._cache_file, self._brought) for key in file._load_index())  # type: ignore[no-untyped-call]
        return any(key[1:] == wanted and numbers in str(key[0]) for key in keys)

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            self._forget_earlier()
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]
        finally:
            self._end_turn()

    def _forget_earlier(self) -> None:
        """Remove functions compiled from earlier sources, because Numba would reuse their file names.

        Whoever is killed between the two would leave the new form listed and the earlier one in its file.
        """
        if not self._cache_file._load_index():  # type: ignore[no-untyped-call]
            for path in Path(self.cache_path).glob(f"{escape(self._impl.filename_base)}.*.nbc"):
                with suppress(OSError):
                    path.unlink()

    def _take_turn(self) -> None:
        """Acquire the lock for compiling the function; continue without it after a timeout or an error."""
        with suppress(Timeout, OSError, NotImplementedError):
            if self._turn is None:
                self._impl.locator.ensure_cache_path()
                self._turn = FileLock(Path(self.cache_path) / f"{self._impl.filename_base}.lock", timeout=PATIENCE)
            self._turn.acquire()

    def _end_turn(self) -> None:
        if self._turn is not None:
            self._turn.release(force=True)

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        folder = Path(self._py_func.__code__.co_filename).parent
        key: tuple[Any, ...] = super()._index_key(sig, codegen)  # type: ignore[no-untyped-call]
        return (*key, _sources(folder), os.environ.get("NUMBA_BOUNDSCHECK"))


@lru_cache
def _sources(folder: Path) -> str:
    """Return the hash of all Python sources of a folder and of this module."""
    found = hashlib.sha256()
    for path in (Path(__file__), *sorted(folder.glob("*.py"))):
        found.update(path.read_bytes())
    return found.hexdigest()
