"""Selection of FFT sizes and interpolation windows by a cost model.

The costs are nanoseconds of one core for a cell of 32 numbers, measured (docs/performance.md); only their ratios count.
"""

from __future__ import annotations

import numpy as np

from steradian.imaging.transforms.windows import Shape, Window, narrowest_window

MAX_PRIME = 127
"""Primes up to this one cost a transform of a record less than a tenth; 226 mirror positions are 2 · 113."""
LINE = 16
"""Numbers that a processor brings at once, about; a line of samples or slices of such a length is read fastest."""
_OVERSAMPLINGS = (1.2, 1.25, 1.3, 1.35, 1.4, 1.5, 1.6, 1.75, 2.0)
_TRANSFORM = 10.0  # a point of a transform
SPREAD_COST = 1.7  # a grid point of a sensor's stencil
GATHER_COST = 4.0  # a tap of 16 modes at one depth index


def fast_size(least: float) -> int:
    """Return the smallest fast FFT size ≥ ``least``: a power of two times a small odd number."""
    least = max(1, int(np.ceil(least - 1e-9)))
    best = 1 << (least - 1).bit_length()
    for odd in (1, 3, 5, 9, 15, 25, 27, 45, 75):
        power = 1
        while power * odd < least:
            power *= 2
        best = min(best, power * odd)
    return best


def fast_record_length(samples: int) -> int:
    """Return the FFT length of the record ≥ ``samples``, longer if a prime factor exceeds :data:`MAX_PRIME`."""
    rest = samples
    for prime in range(2, MAX_PRIME + 1):
        while rest % prime == 0:
            rest //= prime
    if rest == 1:
        return samples
    from scipy.fft import next_fast_len

    return int(next_fast_len(samples))


def fast_multiple(least: float) -> int:
    """Return the smallest fast FFT size ≥ ``least`` that is a multiple of :data:`LINE`."""
    from scipy.fft import next_fast_len

    return LINE * int(next_fast_len(-(-int(least) // LINE)))


def _sized(window: Shape | Window, share: float, needed: int, size: int) -> Window | None:
    if isinstance(window, Window):
        return window
    return narrowest_window(window, share, round(size / needed - 5e-4, 3))


def lateral_grid(
    modes: tuple[int, int], sensors: int, window: Shape | Window, share: float
) -> tuple[tuple[int, int], Window]:
    """Return grid size (nx, ny) and window for ``sensors`` non-uniform sensors; nx = 1 in 2-D (modes[0] = 1)."""
    best: tuple[float, tuple[int, int], Window] | None = None
    for factor in _OVERSAMPLINGS if not isinstance(window, Window) else (window.oversampling,):
        sizes = [1 if n == 1 else fast_size(factor * n) for n in modes]
        tight = min((s / n, a) for a, (s, n) in enumerate(zip(sizes, modes, strict=True)) if n > 1)[1]
        found = _sized(window, share, modes[tight], sizes[tight])
        if found is None:
            continue
        nx, ny = (1 if n == 1 else max(s, fast_size(2 * found.width + 2)) for s, n in zip(sizes, modes, strict=True))
        taps = found.width ** (1 if nx == 1 else 2)
        cost = sensors * taps * SPREAD_COST + nx * (ny + (modes[1] if nx > 1 else 0)) * _TRANSFORM
        if best is None or cost < best[0]:
            best = cost, (nx, ny), found
    assert best is not None  # noqa: S101
    return best[1], best[2]


def time_grid(samples: int, record: float, window: Shape | Window, share: float) -> tuple[int, Window]:
    """Return FFT length and window over time for records with ``samples`` non-zero around their centre."""
    best: tuple[float, int, Window] | None = None
    for factor in _OVERSAMPLINGS if not isinstance(window, Window) else (window.oversampling,):
        length = fast_size(factor * samples)
        found = _sized(window, share, samples, length)
        if found is None:
            continue
        length = max(length, fast_size(2 * found.width + 2))
        cost = length * _TRANSFORM + record / 2 * found.width * GATHER_COST
        if best is None or cost < best[0]:
            best = cost, length, found
    assert best is not None  # noqa: S101
    return best[1], best[2]
