"""Geometric acoustics of Gaussian balls in a layered medium: travel times by Fermat's principle, ray-tube spreading.

Independent of the reconstruction, which knows no rays. Valid where the medium does not change over a wavelength, that
is not for balls within a wavelength of a boundary; waves beyond critical angles and echoes are left out.

Attenuation is in closed form for each frequency. With the sign e^{−iωt} of ``numpy.fft`` and the complex wave numbers
K′ = conj K, whose imaginary parts decay, a ball of standard deviation s in the layer with c and K′ has the spectrum

    A·√(2π)·s³/2·iω/c²·e^{−K′²s²/2}·e^{−iΣ K′_i ℓ_i}·(spreading)

at the end of a ray with the lengths ℓ_i in the layers. In one medium it solves the Helmholtz equation with the source
iω/c²·p₀ (P. J. La Rivière, J. Zhang and M. A. Anastasio, Opt. Lett. 31, 781, 2006).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fabry_perot.simulator.phantoms import Balls
from steradian.core.exceptions import InvalidInput
from steradian.imaging.medium import LayerPath, Medium

Floats = NDArray[np.float64]
_BISECTIONS = 60


def layered_pressure(
    balls: Balls,
    positions: ArrayLike,
    medium: Medium,
    *,
    samples: int,
    sampling_interval: float,
    time_zero: float = 0.0,
) -> NDArray[np.float64]:
    """Return the simulated A-lines of Gaussian balls in a layered medium at sensors on the plane z = 0.

    Parameters
    ----------
    balls
        The object; each ball counts as inside the layer of its centre.
    positions
        (M, 2) x, y in m.
    medium
        Layers; with densities, the pressure's plane-wave transmission at the ray's angle is included. An attenuation
        acts along the ray.
    samples
        N_t, the first one at ``time_zero`` after the laser pulse.
    sampling_interval, time_zero
        In s.

    Returns
    -------
    ndarray
        (M, N_t), in the unit of the amplitudes.

    Raises
    ------
    InvalidInput
        When the positions are no points of the plane.
    """
    where = np.asarray(positions, np.float64)
    if where.ndim != 2 or where.shape[1] != 2:
        raise InvalidInput("positions", f"an array of shape {where.shape}", "shape (M, 2), in m")
    times = time_zero + sampling_interval * np.arange(samples)
    traces = np.zeros((len(where), samples))
    for centre, sigma, amplitude in zip(balls.centres, balls.sigmas, balls.amplitudes, strict=True):
        path = next(path for path in medium.layer_paths() if centre[2] <= path.bottom)
        arrival, loudness, lengths = trace_rays(path, np.linalg.norm(where - centre[:2], axis=1), float(centre[2]))
        if medium.lossy:
            pulses = _attenuated(path, sigma, arrival, lengths, samples, sampling_interval, time_zero)
            traces += (amplitude * loudness)[:, None] * pulses
            continue
        ahead = path.sound_speed * (arrival[:, None] - times)
        traces += (amplitude * loudness)[:, None] * ahead / 2 * np.exp(-(ahead**2) / (2 * sigma**2))
    return traces


def _attenuated(
    path: LayerPath, sigma: float, arrival: Floats, lengths: Floats, samples: int, interval: float, time_zero: float
) -> Floats:
    """Return the pulses (M, N_t) of a ball of unit amplitude, without spreading, after rays of (L, M) lengths."""
    length = 2 * int(samples + max(0.0, time_zero) / interval)
    f = np.arange(1, length // 2 + 1) / (length * interval)
    omega = 2 * np.pi * f
    excess = [
        np.zeros(len(f), complex) if each.attenuation is None else np.conj(each.attenuation.excess(f))
        for each in path.layers
    ]
    speed = path.sound_speed
    source = np.sqrt(2 * np.pi) * sigma**3 / 2 * 1j * omega / speed**2
    source = source * np.exp(-((omega / speed + excess[-1]) ** 2) * sigma**2 / 2)
    way = omega * (arrival[:, None] - time_zero) + lengths.T @ np.array(excess)
    spectrum = np.zeros((len(arrival), length // 2 + 1), np.complex128)
    spectrum[:, 1:] = source * np.exp(-1j * way)
    found: Floats = np.fft.irfft(spectrum, length, axis=1)[:, :samples] / interval
    return found


def trace_rays(path: LayerPath, offsets: Floats, depth: float) -> tuple[Floats, Floats, Floats]:
    """Return travel time, amplitude and lengths of the rays from a point to sensors on the film.

    Parameters
    ----------
    path
        Layers from the film to that of the point.
    offsets
        (M,) lateral distances of the sensors, in m.
    depth
        Of the point, in m.

    Returns
    -------
    Arrays (M,): times in s, and amplitudes in 1/m (1/R in a homogeneous medium); (L, M) lengths in m in each layer.
    """
    speeds = np.array([layer.sound_speed for layer in path.layers])[:, None]
    above = [layer.thickness or 0.0 for layer in path.overlying]
    lengths = np.array([*above, depth - path.top])[:, None]
    # ray parameter p = sin θ / c, the same in all layers (Snell); the offset rises with it
    low, high = np.zeros(len(offsets)), np.full(len(offsets), (1 - 1e-12) / speeds.max())
    for _ in range(_BISECTIONS):
        p = (low + high) / 2
        short = (lengths * _tangents(speeds, p)).sum(axis=0) < offsets
        low, high = np.where(short, p, low), np.where(short, high, p)
    p = (low + high) / 2
    cosines = np.sqrt(1 - (speeds * p) ** 2)
    time = (lengths / (speeds * cosines)).sum(axis=0)
    widening = (lengths * speeds / cosines**3).sum(axis=0)  # of the offset per ray parameter
    # solid angle of a ray tube at the point over its cross section at the film, as if without boundaries
    own = speeds[-1] ** 2 / cosines[-1] ** 2
    spread = own * np.divide(p, offsets, out=1 / widening, where=offsets > 1e-9 * depth) / widening
    sines = speeds[-1] * p
    return time, np.sqrt(spread) * path.transmission(sines), lengths / cosines


def _tangents(speeds: Floats, p: Floats) -> Floats:
    sines = speeds * p
    tangents: Floats = sines / np.sqrt(np.maximum(1 - sines**2, 1e-30))
    return tangents
