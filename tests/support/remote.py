"""Arrays that lie elsewhere, as CuPy's do: NumPy's functions take them, but they do not mix with arrays in memory."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin


class Remote(NDArrayOperatorsMixin):
    """An array of another device.

    It refuses what CuPy's refuse: to become NumPy's without being asked (``get``), and company of NumPy's arrays.
    """

    __cuda_array_interface__: ClassVar[dict[str, Any]] = {}

    def __init__(self, values: np.ndarray) -> None:
        self.values = values

    def __array__(self, *_: object, **__: object) -> np.ndarray:
        raise TypeError("implicit conversion to an array in memory")

    def __array_ufunc__(self, ufunc: Any, method: str, *given: Any, **how: Any) -> Any:
        if method != "__call__":
            return NotImplemented
        return _wrapped(ufunc(*map(_taken, given), **{name: _taken(value) for name, value in how.items()}))

    def __array_function__(self, function: Any, _: Any, given: Any, how: Any) -> Any:
        how = {name: _taken(value) for name, value in how.items()}
        if function is np.asarray:  # the way there
            return Remote(np.array(given[0], **how))
        return _wrapped(function(*map(_taken, given), **how))

    def __getitem__(self, key: Any) -> Any:
        return _wrapped(self.values[_taken(key)])

    def __setitem__(self, key: Any, value: Any) -> None:
        self.values[_taken(key)] = _taken(value)

    def __getattr__(self, name: str) -> Any:
        found = getattr(self.values, name)
        return (lambda *given, **how: _wrapped(found(*given, **how))) if callable(found) else found

    def __float__(self) -> float:
        return float(self.values)

    def __bool__(self) -> bool:
        return bool(self.values)

    def __len__(self) -> int:
        return len(self.values)

    def get(self) -> np.ndarray:
        """Bring it here."""
        return self.values.copy()


def _taken(value: Any) -> Any:
    if isinstance(value, Remote):
        return value.values
    if isinstance(value, tuple):
        return tuple(map(_taken, value))
    if isinstance(value, np.ndarray) and value.ndim:
        raise TypeError("an array in memory beside one that is not")
    return value


def _wrapped(value: Any) -> Any:
    return Remote(np.asarray(value)) if isinstance(value, np.ndarray | np.generic) else value
