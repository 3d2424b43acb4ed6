"""Twiddle-factor tables of the FFTs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from steradian.imaging.engines.numba.kernel_args import Factors
from steradian.imaging.volume import RealArray

_RADICES = (8, 4, 5, 3, 2)
GENERIC_BLOCK = 2  # outputs a generic pass computes at once; the last block is padded


@dataclass(frozen=True, slots=True)
class FftTables:
    """Twiddle factors and passes of one forward FFT of ``size`` points.

    Parameters
    ----------
    size
        Number of points n.
    radices
        Radix of each Stockham pass; their product is n.
    twiddles
        Per pass, for p = 0 … n_pass/r − 1 and k = 1 … r−1 the pair (cos, −sin) of 2πpk/n_pass, flattened.
    twiddle_starts
        Where each pass begins in ``twiddles``.
    generic
        For each radix without a butterfly of its own the cosines and sines of 2πkn/r in blocks of outputs.
    generic_starts
        Where each pass begins in ``generic``.
    scratch
        Cells of temporary memory that the generic passes need.
    """

    size: int
    radices: NDArray[np.int64]
    twiddles: RealArray
    twiddle_starts: NDArray[np.int64]
    generic: RealArray
    generic_starts: NDArray[np.int64]
    scratch: int

    @property
    def kernel_args(self) -> Factors:
        """FFT tables as argument tuple of the kernels."""
        return Factors(self.size, self.radices, self.twiddles, self.twiddle_starts, self.generic, self.generic_starts)


def factorise(size: int) -> list[int]:
    """Return the radices of the FFT passes for ``size`` points: primes above 5 first, then 8, 4, 5, 3 and 2."""
    rest, primes = size, []
    divisor = 7
    small = size
    for p in (2, 3, 5):
        while small % p == 0:
            small //= p
    rest = small
    while rest > 1:
        if divisor * divisor > rest:
            divisor = rest
        while rest % divisor == 0:
            primes.append(divisor)
            rest //= divisor
        divisor += 2
    rest = size
    for p in primes:
        rest //= p
    radices = list(primes)
    for radix in _RADICES:
        while rest % radix == 0:
            radices.append(radix)
            rest //= radix
    return radices


def table_bytes(size: int) -> int:
    """Return the peak bytes of the FFT tables for ``size`` points during construction in float64."""
    numbers, length = 0, size
    for radix in factorise(size) if size > 1 else []:
        numbers += 2 * (length // radix) * (radix - 1)
        numbers += 0 if radix in _RADICES else 2 * (radix // 2) ** 2
        length //= radix
    return 8 * numbers


@lru_cache(maxsize=64)
def transform(size: int, dtype: str) -> FftTables:
    """Return the FFT tables for ``size`` points in float32 or float64 (cached)."""
    twiddles: list[NDArray[np.float64]] = []
    generic: list[NDArray[np.float64]] = []
    twiddle_starts, generic_starts, scratch = [], [], 0
    length = size
    for radix in (radices := factorise(size) if size > 1 else []):
        twiddle_starts.append(sum(map(len, twiddles)))
        generic_starts.append(sum(map(len, generic)))
        p, k = np.arange(length // radix)[:, None], np.arange(1, radix)[None, :]
        angle = 2 * np.pi * ((p * k) % length) / length
        twiddles.append(np.stack([np.cos(angle), -np.sin(angle)], axis=-1).ravel())
        if radix not in _RADICES:
            generic.append(_generic_table(radix))
            scratch = max(scratch, 2 * (radix // 2) + 2)
        length //= radix
    return FftTables(
        size,
        np.array(radices, np.int64),
        np.concatenate([*twiddles, np.zeros(1)]).astype(dtype),
        np.array(twiddle_starts, np.int64),
        np.concatenate([*generic, np.zeros(1)]).astype(dtype),
        np.array(generic_starts, np.int64),
        scratch,
    )


def _generic_table(radix: int) -> NDArray[np.float64]:
    half = radix // 2
    blocks = -(-half // GENERIC_BLOCK)
    table = np.zeros((blocks * GENERIC_BLOCK, half, 2))
    k, n = np.arange(1, half + 1)[:, None], np.arange(1, half + 1)[None, :]
    angle = 2 * np.pi * ((k * n) % radix) / radix
    table[:half] = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    # [block][n][k in block][cos, sin]
    return table.reshape(blocks, GENERIC_BLOCK, half, 2).transpose(0, 2, 1, 3).ravel()
