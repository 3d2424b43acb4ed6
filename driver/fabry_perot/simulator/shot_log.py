"""Log of a simulated laser's last shots, in preallocated memory."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from typing import overload


class ShotLog(Sequence[tuple[int, int]]):
    """Ring buffer with time (simulator's, µs) and point of each of the last shots, oldest first.

    A list of pairs would take six times as much, and grow for as long as the first scan lasts.

    Parameters
    ----------
    most
        Shots that it remembers.
    """

    def __init__(self, most: int) -> None:
        self._most, self._count = most, 0
        self._numbers = array("q", bytes(16 * most))

    def append(self, shot: tuple[int, int]) -> None:
        """Append a shot, replacing the oldest one when full."""
        at = 2 * (self._count % self._most)
        self._numbers[at], self._numbers[at + 1] = shot
        self._count += 1

    def __len__(self) -> int:
        return min(self._count, self._most)

    @overload
    def __getitem__(self, index: int) -> tuple[int, int]: ...
    @overload
    def __getitem__(self, index: slice) -> list[tuple[int, int]]: ...
    def __getitem__(self, index: int | slice) -> tuple[int, int] | list[tuple[int, int]]:
        if isinstance(index, slice):
            return [self[one] for one in range(*index.indices(len(self)))]
        number = range(len(self))[index]
        at = 2 * ((self._count - len(self) + number) % self._most)
        return self._numbers[at], self._numbers[at + 1]
