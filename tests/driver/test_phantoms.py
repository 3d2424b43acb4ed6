"""The closed-form pressure against independent numerics, and the yarn's shape."""

from __future__ import annotations

import numpy as np
import pytest

from fabry_perot.simulator import phantoms

C = 1500.0


def one_ball(centre=(0.2e-3, -0.1e-3, 1.5e-3), sigma=50e-6, amplitude=2.0) -> phantoms.Balls:
    return phantoms.Balls(np.array([centre]), np.array([sigma]), np.array([amplitude]))


NODES, WEIGHTS = np.polynomial.legendre.leggauss(120)


def spherical_mean(ball: phantoms.Balls, position: np.ndarray, radius: float) -> float:
    """Mean of the initial pressure over a sphere: quadrature over the cosine of the angle to the ball's direction."""
    distance = np.linalg.norm(ball.centres[0] - position)
    sigma = ball.sigmas[0]
    width = min(2.0, 50 * sigma**2 / (distance * radius))  # beyond, the ball is below exp(-50)
    cosines = 1 - width * (NODES + 1) / 2
    squared = distance**2 + radius**2 - 2 * distance * radius * cosines
    values = ball.amplitudes[0] * np.exp(-squared / (2 * sigma**2))
    return float(np.sum(WEIGHTS * values) * width / 4)


def test_one_balls_pressure_is_poissons_formula_evaluated_by_quadrature():
    """p = d/dt (t · spherical mean of p0 over the sphere of radius ct): Kirchhoff and Poisson, no ball formula used."""
    ball, position = one_ball(), np.array([0.5e-3, 0.3e-3, 0.0])
    arrival = np.linalg.norm(ball.centres[0] - position) / C
    times = arrival + np.linspace(-150e-9, 150e-9, 61)
    h = 1e-10
    expected = [
        ((t + h) * spherical_mean(ball, position, C * (t + h)) - (t - h) * spherical_mean(ball, position, C * (t - h)))
        / (2 * h)
        for t in times
    ]
    got = phantoms.pressure(ball, position[None], times, C)[0]
    assert np.abs(got - expected).max() < 2e-5 * np.abs(expected).max()


def test_the_pressure_obeys_the_radial_wave_equation():
    """(R p)_tt = c² (R p)_RR, checked by finite differences away from the source."""
    ball = one_ball(centre=(0.0, 0.0, 0.0))
    h = 1e-6
    radii = 0.6e-3 + h * np.arange(-200, 201)
    positions = np.column_stack([radii, 0 * radii, 0 * radii])
    dt = h / C
    values = [radii * phantoms._dense(ball, positions, np.array([0.4e-6 + k * dt]), C)[:, 0] for k in (-1, 0, 1)]
    in_time = values[0] - 2 * values[1] + values[2]
    in_space = values[1][:-2] - 2 * values[1][1:-1] + values[1][2:]
    assert np.abs(in_time[1:-1] - in_space).max() < 1e-3 * np.abs(in_space).max()


def test_at_time_zero_the_pressure_is_the_initial_pressure_also_inside_a_ball():
    balls = phantoms.yarn(3)
    places = balls.centres[::40] + 20e-6
    fields = phantoms.pressure(balls, places, np.array([0.0]), C)[:, 0]
    expected = [phantoms.initial_pressure(balls, [x], [y], [z])[0, 0, 0] for x, y, z in places]
    assert np.allclose(fields, expected, rtol=1e-5)


@pytest.mark.parametrize("start", [0.0, 1e-6, -0.2e-6])
def test_the_fast_windowed_evaluation_equals_the_full_formula(start):
    balls = phantoms.yarn(1)
    random = np.random.default_rng(0)
    positions = random.uniform(-6e-3, 6e-3, (7, 2))
    positions[0] = 0
    times = start + 8e-9 * np.arange(900)
    fast = phantoms.pressure(balls, positions, times, C)
    full = phantoms._dense(balls, phantoms._positions(positions), times, C)
    assert fast.dtype == np.float32
    assert fast.shape == (7, 900)
    assert np.abs(fast - full).max() < 3e-7 * np.abs(full).max()


def test_sensors_close_to_a_ball_are_evaluated_in_full():
    ball = one_ball(centre=(0, 0, 100e-6))
    times = 4e-9 * np.arange(200)
    fast = phantoms.pressure(ball, [[0.0, 0.0], [50e-6, 0.0], [5e-3, 0.0]], times, C)
    full = phantoms._dense(ball, phantoms._positions([[0.0, 0.0], [50e-6, 0.0], [5e-3, 0.0]]), times, C)
    assert np.abs(fast - full).max() < 1e-6 * np.abs(full).max()


def test_unequally_spaced_times_give_the_same_pressure():
    ball = one_ball()
    times = np.array([0.9e-6, 0.95e-6, 1.0e-6, 1.02e-6, 1.2e-6])
    uneven = phantoms.pressure(ball, [[0.0, 0.0]], times, C)[0]
    single = [phantoms.pressure(ball, [[0.0, 0.0]], np.array([t]), C)[0, 0] for t in times]
    assert np.array_equal(uneven, np.array(single, np.float32))


def test_a_row_does_not_depend_on_which_others_are_computed_with_it():
    balls = phantoms.yarn(0)
    positions = np.random.default_rng(1).uniform(-6e-3, 6e-3, (40, 2))
    times = 8e-9 * np.arange(1024)
    together = phantoms.pressure(balls, positions, times, C)
    for index in (0, 13, 39):
        assert np.array_equal(phantoms.pressure(balls, positions[index], times, C)[0], together[index])


def test_the_initial_pressure_volume_has_its_axes_in_the_order_x_y_z():
    ball = one_ball(centre=(1e-3, -2e-3, 3e-3), sigma=100e-6)
    x, y, z = np.arange(-3e-3, 3e-3, 1e-4), np.arange(-4e-3, 4e-3, 1e-4), np.arange(0, 5e-3, 1e-4)
    volume = phantoms.initial_pressure(ball, x, y, z)
    assert volume.shape == (60, 80, 50)
    assert volume.dtype == np.float32
    i, j, k = np.unravel_index(volume.argmax(), volume.shape)
    assert (x[i], y[j], z[k]) == pytest.approx((1e-3, -2e-3, 3e-3), abs=1e-9)
    assert volume.max() == pytest.approx(2.0, rel=1e-3)


@pytest.mark.parametrize("seed", range(5))
def test_the_yarn_is_continuous_and_lies_where_the_paper_has_its_object(seed):
    balls = phantoms.yarn(seed)
    low, high = balls.centres.min(axis=0), balls.centres.max(axis=0)
    assert np.all(np.abs(balls.centres[:, :2]) < 3.2e-3)
    assert np.all(high[:2] - low[:2] > 4.5e-3)
    assert low[2] > 2.5e-3
    assert high[2] < 4.7e-3
    assert np.all((balls.sigmas >= 40e-6) & (balls.sigmas <= 50e-6))
    gaps = np.linalg.norm(np.diff(balls.centres, axis=0), axis=1)
    assert np.all(gaps < 1.3 * balls.sigmas[1:])
    assert np.linalg.norm(balls.centres[0] - balls.centres[-1]) > 0.5e-3, "two loose ends"


def test_the_yarn_is_the_same_for_the_same_seed_and_another_for_another():
    assert np.array_equal(phantoms.yarn(4).centres, phantoms.yarn(4).centres)
    assert not np.array_equal(phantoms.yarn(4).centres, phantoms.yarn(5).centres)


def test_wrong_shapes_are_refused():
    with pytest.raises(ValueError, match="centres"):
        phantoms.Balls(np.zeros((2, 2)), np.ones(2), np.ones(2))
    with pytest.raises(ValueError, match="positions"):
        phantoms.pressure(one_ball(), np.zeros((3, 4)), np.zeros(1), C)
