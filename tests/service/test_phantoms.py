"""Phantoms have the pressure that physics says, by formulas and by another project's simulation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fabry_perot.simulator import phantoms as driver
from steradian import InvalidInput, phantoms
from steradian.imaging import Volume, VoxelAxes
from steradian.phantoms.targets import chart_bars

DATA = Path(__file__).parents[1] / "data"
RECORD = {"samples": 700, "sampling_interval": 10e-9, "sound_speed": 1500.0}


@pytest.fixture
def random() -> np.random.Generator:
    return np.random.default_rng(3)


def test_the_fast_pressure_is_the_drivers_closed_form(random) -> None:
    """Also for balls that touch the sensor plane, where the wave going inwards counts."""
    centres = np.column_stack([*(random.random((2, 30)) - 0.5) * 4e-3, random.random(30) * 4e-3])
    balls = phantoms.Balls(centres, random.uniform(2e-5, 9e-5, 30), random.normal(size=30))
    positions = (random.random((50, 2)) - 0.5) * 5e-3
    fast = phantoms.pressure(balls, positions, **RECORD)
    exact = driver.pressure(balls, positions, np.arange(700) * 10e-9, 1500.0)
    assert np.abs(fast - exact).max() < 1e-5 * np.abs(exact).max()


def test_a_late_first_sample_only_cuts_the_record() -> None:
    balls, where = phantoms.yarn(2), np.array([[0.0, 1e-3], [2e-3, 0.0]])
    whole = phantoms.pressure(balls, where, **RECORD)
    late = phantoms.pressure(balls, where, **RECORD | {"samples": 500}, time_zero=200 * 10e-9)
    assert_allclose(late, whole[:, 200:], atol=1e-6)


def test_the_films_directivity_is_the_simulated_scanners(random) -> None:
    balls, where = phantoms.vessels(1), (random.random((9, 2)) - 0.5) * 1e-2
    ours = phantoms.pressure(balls, where, directivity=phantoms.angular_response, **RECORD)
    theirs = driver.pressure(balls, where, np.arange(700) * 10e-9, 1500.0, phantoms.angular_response)
    assert np.abs(ours - theirs).max() < 1e-3 * np.abs(theirs).max()


def test_pressure_with_positions_off_the_plane_is_refused() -> None:
    with pytest.raises(InvalidInput):
        phantoms.pressure(phantoms.yarn(), np.zeros((4, 3)), **RECORD)


def test_the_films_band_takes_half_the_power_at_22_mhz() -> None:
    time = np.arange(4096) * 4e-9
    for frequency, gain in ((1e6, 1.0), (22e6, np.sqrt(0.5))):
        wave = np.sin(2 * np.pi * frequency * time).astype(np.float32)[None]
        assert_allclose(phantoms.band_limited(wave, 4e-9)[0, 1000:3000].std() / wave.std(), gain, atol=0.01)


def test_propagate_2d_matches_kwave_simulation() -> None:
    """The tree that k-Wave simulated: what remains between its A-lines and ours is its 30 dB of noise."""
    with np.load(DATA / "tree_kwave_slice.npz") as file:
        data = dict(file)
    spacing = float(data["dx"])
    x = spacing * (np.arange(1024.0) - 512)
    truth = Volume(
        data["p0"].T.astype(np.float32) / 255, VoxelAxes(x, None, spacing * np.arange(256.0)), (spacing, spacing)
    )
    traces = phantoms.propagate_2d(
        truth, samples=1024, sampling_interval=float(data["dt"]), sound_speed=float(data["c"])
    )[data["sensors"]]
    theirs = data["traces"].astype(np.float64)
    scale = np.vdot(traces, theirs) / np.vdot(traces, traces)
    rest = theirs - scale * traces
    assert np.linalg.norm(rest) < 10 ** (-29 / 20) * np.linalg.norm(theirs)
    shift = np.linalg.norm(theirs[:, 1:] - scale * traces[:, :-1])  # one sample late would show
    assert shift > 3 * np.linalg.norm(rest)


def test_nothing_comes_round_the_periodic_domain() -> None:
    """Twice the record must begin with the same waves, although it is computed on a larger domain."""
    x, z = 1e-4 * np.arange(-32.0, 32), 1e-4 * np.arange(24.0)
    ball = np.exp(-((x[:, None] - 1e-3) ** 2 + (z[None] - 1.2e-3) ** 2) / (2 * 1.8e-4**2)).astype(np.float32)
    image = Volume(ball, VoxelAxes(x, None, z), (1e-4, 1e-4))
    short, long = (
        phantoms.propagate_2d(image, samples=n, sampling_interval=2e-8, sound_speed=1500.0) for n in (150, 300)
    )
    assert_allclose(long[:, :150], short, atol=2e-5 * np.abs(short).max())


def test_line_pressure_refuses_volumes() -> None:
    axis = np.arange(4.0)
    volume = Volume(np.zeros((4, 4, 4), np.float32), VoxelAxes(axis, axis, axis), (1.0, 1.0, 1.0))
    with pytest.raises(InvalidInput):
        phantoms.propagate_2d(volume, samples=8, sampling_interval=1e-8, sound_speed=1500.0)


@pytest.mark.parametrize("convention", ["peak", "rms"])
def test_noise_has_the_stated_level_by_the_stated_convention(convention, random) -> None:
    traces = np.zeros((50, 400), np.float32)
    traces[:, 100:120] = random.normal(size=(50, 20))
    noise = phantoms.add_noise(traces, 20, convention=convention, seed=4) - traces
    signal = np.abs(traces).max() if convention == "peak" else np.sqrt(np.mean(traces**2))
    assert_allclose(noise.std(), signal / 10, rtol=0.02)
    assert np.array_equal(phantoms.add_noise(traces, 20, convention=convention, seed=4) - traces, noise)
    assert not np.array_equal(phantoms.add_noise(traces, 20, convention=convention, seed=5) - traces, noise)


def test_an_unknown_convention_is_refused() -> None:
    with pytest.raises(InvalidInput, match="peak, rms"):
        phantoms.add_noise(np.ones((2, 2)), 30, convention="power")  # type: ignore[arg-type]


def test_bars_of_the_chart_are_even_inside_and_empty_between() -> None:
    chart = phantoms.chart(groups=1, size=1e-3, largest=160e-6, depth=2e-3)
    left, right, low, high = chart_bars(groups=1, size=1e-3, largest=160e-6)[1]
    middle, beside, y = (left + right) / 2, right + (right - left) / 2, (low + high) / 2
    inside = driver.initial_pressure(chart, middle + np.linspace(-4e-5, 4e-5, 30), [y], [2e-3])
    assert_allclose(inside, 1, atol=5e-3)
    assert driver.initial_pressure(chart, [beside], [y], [2e-3]).max() < 1e-3
    edge = driver.initial_pressure(chart, [left, right], [y], [2e-3])
    assert_allclose(edge, 0.5, atol=0.05)


def test_the_star_has_its_sectors_and_its_core() -> None:
    star = phantoms.star(sectors=24, diameter=1e-3, core=1e-4, depth=1e-3)
    axis = np.linspace(-0.6e-3, 0.6e-3, 481)
    image = driver.initial_pressure(star, axis, axis, [1e-3])[..., 0]
    angle = 2 * np.pi * np.arange(2000) / 2000
    i, j = (np.rint((0.4e-3 * f(angle) + 0.6e-3) / (axis[1] - axis[0])).astype(int) for f in (np.cos, np.sin))
    spectrum = np.abs(np.fft.rfft(image[i, j]))
    assert spectrum[1:].argmax() + 1 == 12
    assert image[240, 240] > 0.95
    assert image[240, :20].max() < 1e-3


def test_vessels_branch_within_their_region_and_differ_by_seed() -> None:
    first, second = phantoms.vessels(0), phantoms.vessels(1)
    for balls in (first, second):
        away = balls.centres - np.array([0, 0, 3.6e-3])
        assert np.hypot(away[:, 0], away[:, 1]).max() < 1.05 * 3.5e-3
        assert np.abs(away[:, 2]).max() < 0.5 * 3.5e-3
        assert_allclose(np.unique(balls.sigmas)[::-1], 110e-6 * 2 ** (-np.arange(6) / 3))
    assert first.centres.shape != second.centres.shape or not np.allclose(first.centres, second.centres)
    axis = driver.initial_pressure(first, *(first.centres[5][:, None]))
    assert 0.9 < float(axis[0, 0, 0]) < 1.1


def test_tree_phantom_is_consistent_across_sizes_and_varies_with_seed() -> None:
    big, small = phantoms.tree(3), phantoms.tree(3, shape=(256, 64), spacing=240e-6)
    assert big.values.min() == 0
    assert big.values.max() == 1
    shrunk = big.values.reshape(256, 4, 64, 4).mean(axis=(1, 3))
    assert np.corrcoef(shrunk.ravel(), small.values.ravel())[0, 1] > 0.85
    assert not np.array_equal(big.values, phantoms.tree(4).values)
    rows, columns = np.nonzero(big.values.T)
    assert 30 < rows.min() < 80
    assert 220 < rows.max() < 235
    assert np.abs(columns - 512).max() < 125
    assert_allclose(np.abs(np.diff(big.axes.z)), 60e-6)


def test_the_truth_of_a_volume_lies_at_its_voxels() -> None:
    balls = phantoms.Balls(np.array([[1e-3, -2e-3, 3e-3]]), np.array([2e-4]), np.array([2.0]))
    x, y, z = 1e-4 * np.arange(-20, 21), 1e-4 * np.arange(-30, 31), 5e-5 * np.arange(100)
    like = Volume(np.zeros((41, 61, 100), np.float32), VoxelAxes(x, y, z), (1e-4, 1e-4, 5e-5))
    truth = phantoms.rasterise(balls, like).values
    assert np.unravel_index(truth.argmax(), truth.shape) == (30, 10, 60)
    assert truth.max() == pytest.approx(2.0)
