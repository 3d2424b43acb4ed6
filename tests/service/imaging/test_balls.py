"""Closed-form sound of Gaussian balls: place, size and amplitude of what is reconstructed."""

from __future__ import annotations

import numpy as np
import pytest

from support.flat import flat_reconstruct

SPEED, INTERVAL, SIDE = 1500.0, 20e-9, 6.4e-3
CENTRES = np.array([[0.0, 0.0, 1.2e-3], [1.1e-3, -0.5e-3, 1.5e-3], [-0.8e-3, 0.9e-3, 0.9e-3]])
AMPLITUDES = np.array([1.0, 0.6, 0.8])
WIDTH = 0.16e-3


def sound(positions: np.ndarray, samples: int, delay: float = 0.0) -> np.ndarray:
    """p(R, t) = A/(2R)·[(R−ct)e^{−(R−ct)²/2s²} + (R+ct)e^{−(R+ct)²/2s²}], summed over the balls."""
    ct = (np.arange(samples) * INTERVAL + delay) * SPEED
    full = np.zeros((len(positions), 3))
    full[:, : positions.shape[1]] = positions
    traces = np.zeros((len(positions), samples))
    for centre, amplitude in zip(CENTRES, AMPLITUDES, strict=True):
        r = np.linalg.norm(full - centre, axis=1)[:, None]
        for d in (r - ct, r + ct):
            traces += amplitude / (2 * r) * d * np.exp(-(d**2) / (2 * WIDTH**2))
    return traces


def lattice(count: int, side: float = SIDE) -> np.ndarray:
    axis = (np.arange(count) - count // 2) * side / count
    return np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)


def scattered(count: int) -> np.ndarray:
    """One sensor in each cell of a lattice, anywhere within the middle of the cell."""
    base = lattice(count)
    rng = np.random.default_rng(0)
    return np.clip(base + (rng.random(base.shape) - 0.5) * 0.6 * SIDE / count, -SIDE / 2, SIDE / 2)


@pytest.mark.parametrize("kind", ["gridded", "scattered"])
def test_balls_come_back_at_their_place_with_their_amplitude(kind: str) -> None:
    positions = lattice(64) if kind == "gridded" else scattered(64)
    volume = flat_reconstruct(
        sound(positions, 160),
        positions,
        sampling_interval=INTERVAL,
        sound_speed=SPEED,
        aperture=SIDE,
        modes=(64, 80),  # unequal, so that exchanged axes show
        weights="voronoi" if kind == "scattered" else None,
        time_padding=2.0,
    )
    assert volume.values.shape == (64, 80, 160)
    for centre, amplitude in zip(CENTRES, AMPLITUDES, strict=True):
        axes = (volume.axes.x, volume.axes.y, volume.axes.z)
        near = [np.abs(a - c) < 0.35e-3 for a, c in zip(axes, centre, strict=True)]
        part = volume.values[np.ix_(*near)]
        peak = np.unravel_index(part.argmax(), part.shape)
        found = [a[n][p] for a, n, p in zip(axes, near, peak, strict=True)]
        np.testing.assert_allclose(found, centre, atol=1.01 * max(volume.spacing))
        # the part of all directions that meets the aperture comes back
        r = np.hypot(np.linalg.norm(lattice(200) - centre[:2], axis=1), centre[2])
        seen = np.sum(centre[2] / r**3) * (SIDE / 200) ** 2 / (2 * np.pi)
        assert part.max() == pytest.approx(seen * amplitude, rel=0.1)


def test_a_delayed_recording_gives_the_same_image_with_its_time_zero() -> None:
    positions = lattice(32)
    common = {"sampling_interval": INTERVAL, "sound_speed": SPEED, "aperture": SIDE, "modes": 32, "time_padding": 2.0}
    plain = flat_reconstruct(sound(positions, 160), positions, **common).values[:, :, 15:75]
    delay = 3.5 * INTERVAL
    late = flat_reconstruct(sound(positions, 160, delay), positions, time_zero=delay, **common).values[:, :, 15:75]
    assert np.linalg.norm(late - plain) < 0.02 * np.linalg.norm(plain)


def test_depth_range_is_a_part_of_the_full_image() -> None:
    positions = scattered(24)
    traces = sound(positions, 150)
    common = {"sampling_interval": INTERVAL, "sound_speed": SPEED, "aperture": SIDE, "modes": (24, 26)}
    full = flat_reconstruct(traces, positions, **common)
    part = flat_reconstruct(traces, positions, depth_range=(0.6e-3, 2.1e-3), **common)
    first = int(np.argmin(np.abs(full.axes.z - part.axes.z[0])))
    assert part.axes.z[0] == pytest.approx(0.6e-3)
    assert part.axes.z[-1] == pytest.approx(2.1e-3)
    scale = np.abs(full.values).max()
    np.testing.assert_allclose(part.values, full.values[:, :, first : first + part.values.shape[2]], atol=1e-6 * scale)


@pytest.mark.long
@pytest.mark.parametrize("modes", [(24, 26), (25, 27)], ids=["even", "odd"])
def test_upsampling_is_the_sinc_interpolation_of_the_image(modes: tuple[int, int]) -> None:
    positions = scattered(24)
    traces = sound(positions, 100)
    common = {"sampling_interval": INTERVAL, "sound_speed": SPEED, "aperture": SIDE, "modes": modes}
    plain = flat_reconstruct(traces, positions, **common)
    fine = flat_reconstruct(traces, positions, upsampling=3, **common)
    from scipy.signal import resample

    expected = resample(resample(plain.values, 3 * modes[0], axis=0), 3 * modes[1], axis=1)
    assert np.abs(fine.values - expected).max() < 1e-5 * np.abs(expected).max()
    np.testing.assert_allclose(fine.axes.x[::3], plain.axes.x, atol=1e-12)


def test_lateral_padding_preserves_grid_and_reduces_wraparound() -> None:
    positions = lattice(32, SIDE)
    source = np.array([0.49 * SIDE, 0.0, 0.8e-3])
    ct = np.arange(128) * INTERVAL * SPEED
    r = np.linalg.norm(np.pad(positions, ((0, 0), (0, 1))) - source, axis=1)[:, None]
    traces = (r - ct) / (2 * r) * np.exp(-((r - ct) ** 2) / (2 * WIDTH**2))
    common = {"sampling_interval": INTERVAL, "sound_speed": SPEED, "aperture": SIDE, "modes": 32}
    plain = flat_reconstruct(traces, positions, **common)
    padded = flat_reconstruct(traces, positions, lateral_padding=2.0, **common)
    assert padded.values.shape == plain.values.shape
    np.testing.assert_allclose(padded.axes.x, plain.axes.x)
    opposite = plain.axes.x < -0.45 * SIDE
    assert np.abs(padded.values[opposite]).max() < 0.5 * np.abs(plain.values[opposite]).max()
    assert padded.mip("z").argmax() // 32 >= 30


def test_a_line_of_sensors_gives_a_plane_image() -> None:
    x = (np.arange(128) - 64) * SIDE / 128
    # a line in 2-D sees cylinders; a pulse of known delay is enough to place one
    centre = (0.7e-3, 1.3e-3)
    t = np.arange(150) * INTERVAL * SPEED
    r = np.hypot(x - centre[0], centre[1])[:, None]
    traces = -(t - r) * np.exp(-((t - r) ** 2) / (2 * WIDTH**2)) / WIDTH / np.sqrt(r)
    volume = flat_reconstruct(traces, x, sampling_interval=INTERVAL, sound_speed=SPEED, aperture=SIDE, modes=128)
    assert volume.values.shape == (128, 150)
    i, n = np.unravel_index(np.abs(volume.values).argmax(), volume.values.shape)
    assert volume.axes.x[i] == pytest.approx(centre[0], abs=1.01 * SIDE / 128)
    assert volume.axes.z[n] == pytest.approx(centre[1], abs=0.1e-3)
