"""Film transfer function over frequency and angle, and its regularised inverse.

In the spectrum of the A-lines over the film the angle is known: a lateral mode j at the frequency κ is a plane wave
from sin θ = |j|/κ. So the response is one number at each (j, κ), which :class:`InverseFilter` divides out with a bound
on the noise, and which the forward model of the iterative reconstruction holds as it is.

Signs: S multiplies e^{+2πift}, as in ``numpy.fft.rfft``. θ is the angle to the film's normal in the coupling medium.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import GAIN

ComplexArray = NDArray[np.complex128]
RealTable = NDArray[np.float64]

MAX_GAIN = 10.0
"""Amplification of a :class:`InverseFilter`, if nothing else is asked for."""


class FilmResponse(Protocol):
    """Protocol of a film's transfer function."""

    def evaluate(self, frequencies: RealTable, sines: RealTable, sound_speed: float) -> ComplexArray:
        """Return the response S (F, S) at frequencies (F,) in Hz and sines (S,); sound speed outside in m/s."""


@dataclass(frozen=True, slots=True)
class ElasticFilm:
    """Elastic-layer model of a film between mirrors on a thick backing, in a fluid (Cox and Beard 2007).

    The signal is the change of the distance between the mirrors, in units of that of a slow wave at normal incidence.
    A plane wave of the fluid makes longitudinal and shear waves up and down the film and down the backing; seven
    boundary conditions (normal displacement and stress, no shear at the fluid; all four at the backing) fix them.

    Parameters
    ----------
    thickness
        Of the film in m (the paper's: 38 µm of Parylene C).
    speeds
        Longitudinal and shear speed in the film, m/s.
    density
        Of the film, kg/m³.
    backing_speeds, backing_density
        Of the backing (default: polycarbonate).
    fluid_density
        Of the coupling medium (default: water).
    """

    thickness: float = 38e-6
    speeds: tuple[float, float] = (2200.0, 1100.0)
    density: float = 1289.0
    backing_speeds: tuple[float, float] = (2180.0, 910.0)
    backing_density: float = 1200.0
    fluid_density: float = 1000.0

    def __post_init__(self) -> None:
        for name in ("thickness", "density", "backing_density", "fluid_density"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InvalidInput(name, getattr(self, name), "a finite number above 0")
        for name in ("speeds", "backing_speeds"):
            pair = getattr(self, name)
            if len(pair) != 2 or not (np.isfinite(pair).all() and 0 < pair[1] < pair[0] * np.sqrt(0.75)):
                raise InvalidInput(
                    name, pair, "longitudinal and shear speed in m/s, the latter below 0.866 of the former"
                )

    def evaluate(self, frequencies: RealTable, sines: RealTable, sound_speed: float) -> ComplexArray:
        """Return the modelled complex response at given frequencies and angles."""
        frequencies, sines = np.asarray(frequencies, np.float64), np.asarray(sines, np.float64)
        still = frequencies.max(initial=1.0) * 1e-6
        omega = 2 * np.pi * np.maximum(frequencies, still)[:, None]
        slow = self._thinning(np.array([[2 * np.pi * still]]), np.zeros((1, 1)), sound_speed)
        # at grazing incidence the matrix is singular: the wave moves no film
        return np.asarray(self._thinning(omega, np.minimum(sines, 1 - 1e-6)[None, :], sound_speed) / slow[0, 0])

    def _thinning(self, omega: RealTable, sines: RealTable, sound_speed: float) -> ComplexArray:
        """Return the film's change of thickness (difference of the mirrors' displacements) for unit pressure."""
        shape = np.broadcast_shapes(omega.shape, sines.shape)
        omega, sines = np.broadcast_to(omega, shape), np.broadcast_to(sines, shape)
        h = self.thickness
        kx = omega * sines / sound_speed
        kz = omega * np.sqrt(1 - sines**2) / sound_speed
        film = [_plane_waves(omega, kx, speed, self.speeds, self.density) for speed in (0, 1)]
        back = [_plane_waves(omega, kx, speed, self.backing_speeds, self.backing_density) for speed in (0, 1)]
        # unknowns: reflected; film P down, P up, S down, S up; backing P down, S down; all as e^{i(ωt − kx x ∓ kz z)}
        matrix = np.zeros((*shape, 7, 7), np.complex128)
        right = np.zeros((*shape, 7), np.complex128)
        stiff = self.density * self.speeds[0] ** 2
        size = omega / self.speeds[0]  # scale of all rows, so that they are of the same order
        rate = self.fluid_density * omega**2
        # fluid: pressure p = e^{−ikz z} + R e^{ikz z}, u_z = ∇p/(ρω²)
        matrix[..., 0, 0] = -1j * kz / rate * stiff * size
        right[..., 0] = -1j * kz / rate * stiff * size
        matrix[..., 1, 0] = 1
        right[..., 1] = -1
        decays = []
        for column, (wave, sign) in enumerate([(w, s) for w in film for s in (1, -1)], start=1):
            u_x, u_z, s_zz, s_xz, k = wave(sign)
            fall = np.exp(-1j * k * h)
            decays.append(fall)
            top, bottom = (np.ones_like(fall), fall) if sign == 1 else (fall, np.ones_like(fall))
            matrix[..., 0, column] = u_z * stiff * size * top
            matrix[..., 1, column] = s_zz * top
            matrix[..., 2, column] = s_xz * top
            matrix[..., 3, column] = u_x * stiff * size * bottom
            matrix[..., 4, column] = u_z * stiff * size * bottom
            matrix[..., 5, column] = s_zz * bottom
            matrix[..., 6, column] = s_xz * bottom
        for column, wave in enumerate(back, start=5):
            u_x, u_z, s_zz, s_xz, _ = wave(1)
            for row, value in zip((3, 4, 5, 6), (u_x * stiff * size, u_z * stiff * size, s_zz, s_xz), strict=True):
                matrix[..., row, column] = -value
        amplitudes = np.linalg.solve(matrix, right[..., None])[..., 0]
        change = np.zeros(shape, np.complex128)
        for column, (wave, sign) in enumerate([(w, s) for w in film for s in (1, -1)], start=1):
            fall = decays[column - 1]
            change += wave(sign)[1] * amplitudes[..., column] * (1 - fall if sign == 1 else fall - 1)
        return change


def _plane_waves(omega: RealTable, kx: RealTable, shear: int, speeds: tuple[float, float], density: float):  # type: ignore[no-untyped-def]
    """Return a function of the direction (1 down, −1 up): u_x, u_z, σ_zz, σ_xz of a unit wave, and its k_z."""
    k = omega / speeds[shear]
    kz = np.sqrt((k**2 - kx**2).astype(np.complex128))
    kz = np.where(kz.imag > 0, -kz, kz)  # e^{−i kz z} falls downwards
    mu = density * speeds[1] ** 2
    lame = density * speeds[0] ** 2 - 2 * mu

    def wave(sign: int) -> tuple[ComplexArray, ...]:
        # displacement along k for P, across it for S; k has the length ω/c, kept as the unit
        down = sign * kz
        u_x, u_z = (kx / k, down / k) if not shear else (down / k, -kx / k)
        s_zz = -1j * (lame * (kx * u_x + down * u_z) + 2 * mu * down * u_z)
        s_xz = -1j * mu * (down * u_x + kx * u_z)
        return np.asarray(u_x), np.asarray(u_z), np.asarray(s_zz), np.asarray(s_xz), kz

    return wave


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredFilm:
    """Film response as a measured table, interpolated linearly, constant beyond its ends.

    Parameters
    ----------
    frequencies
        (F,) rising, in Hz.
    angles
        (A,) rising, in radians, 0 … π/2.
    gains
        (F, A), real or complex.
    """

    frequencies: ArrayLike
    angles: ArrayLike
    gains: ArrayLike

    def __post_init__(self) -> None:
        f, a, g = np.asarray(self.frequencies), np.asarray(self.angles), np.asarray(self.gains)
        for name, axis in (("frequencies", f), ("angles", a)):
            if axis.ndim != 1 or axis.size == 0 or not np.isfinite(axis).all() or not (np.diff(axis) > 0).all():
                raise InvalidInput(name, f"an array of shape {axis.shape}", "rising finite numbers")
        if a[0] < 0 or a[-1] > np.pi / 2 + 1e-9:
            raise InvalidInput("angles", f"{a[0]:g} … {a[-1]:g}", "0 … π/2 (rad)")
        if g.shape != (f.size, a.size) or not np.isfinite(g).all():
            raise InvalidInput("gains", f"an array of shape {g.shape}", f"finite numbers of shape ({f.size}, {a.size})")

    def evaluate(self, frequencies: RealTable, sines: RealTable, sound_speed: float) -> ComplexArray:
        """Return the complex response interpolated from the table."""
        gains = np.asarray(self.gains, np.complex128)
        angles = np.arcsin(np.clip(sines, 0.0, 1.0))
        across = np.stack([np.interp(angles, np.asarray(self.angles, np.float64), row) for row in gains])
        known = np.asarray(self.frequencies, np.float64)
        return np.stack([np.interp(frequencies, known, column) for column in across.T], axis=1)


@dataclass(frozen=True, slots=True)
class InverseFilter:
    """Regularised inverse of a film response: conj(S)/(|S|² + ε), ε = 1/(4·max_gain²).

    No wave is amplified more than ``max_gain`` times, and so is no noise; what the film passes with |S| ≥ 1.5/max_gain
    comes back to 90 % at least, and what it passes less of is not blown up.

    Parameters
    ----------
    response
        Of the film.
    max_gain
        Largest amplification, from 1 to 10,000.
    """

    response: FilmResponse
    max_gain: float = MAX_GAIN

    def __post_init__(self) -> None:
        object.__setattr__(self, "max_gain", GAIN.check("max_gain", self.max_gain))

    def evaluate(self, frequencies: RealTable, sines: RealTable, sound_speed: float) -> ComplexArray:
        """Return the complex gain of the inverse filter at given frequencies and angles."""
        s = self.response.evaluate(frequencies, sines, sound_speed)
        return np.asarray(np.conj(s) / (np.abs(s) ** 2 + 0.25 / self.max_gain**2))


def tabulate(
    response: FilmResponse | None, *, nyquist: float, bandwidth: float, sound_speed: float, signed: bool = False
) -> tuple[RealTable, RealTable]:
    """Return the kernels' table of a response (2, F, S), amplitude and phase in turns, and its rows per κ and sine.

    Parameters
    ----------
    response
        None gives a table of one entry, which the kernels take as no response.
    nyquist
        Highest frequency in Hz.
    bandwidth
        The same in units of κ.
    sound_speed
        In m/s.
    signed
        Whether the response passes through zero: amplitudes then have signs, so that phases do not jump.
    """
    if response is None:
        return np.ones((2, 1, 1)), np.ones(2)
    frequencies, sines = np.linspace(0, nyquist, _FREQUENCIES), np.linspace(0, 1, _SINES)
    values = response.evaluate(frequencies, sines, sound_speed)
    if values.shape != (_FREQUENCIES, _SINES) or not np.isfinite(values).all():
        raise InvalidInput("response", f"values of shape {values.shape}", "a finite number at each frequency and angle")
    if signed:
        turns = np.unwrap(np.angle(values**2) / (4 * np.pi), axis=0, period=0.5)  # but for half turns
        turns += np.unwrap(turns[_FREQUENCIES // 8], period=0.5) - turns[_FREQUENCIES // 8]
        steps = np.array([(_FREQUENCIES - 1) / bandwidth, _SINES - 1.0])
        return np.stack([(values * np.exp(-2j * np.pi * turns)).real, turns]), steps
    turns = np.unwrap(np.angle(values), axis=0) / (2 * np.pi)
    turns -= np.rint(turns[_FREQUENCIES // 8])  # neighbouring angles on the same branch
    return np.stack([np.abs(values), turns]), np.array([(_FREQUENCIES - 1) / bandwidth, _SINES - 1.0])


_FREQUENCIES, _SINES = 257, 129  # of the table
