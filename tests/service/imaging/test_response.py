"""The film's response: what it takes away comes back, and noise is amplified no more than stated."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fabry_perot.simulator.film import directivity, low_pass
from fabry_perot.simulator.phantoms import Balls, pressure
from steradian.core.exceptions import InvalidInput
from steradian.imaging import ElasticFilm, InverseFilter, MeasuredFilm
from steradian.imaging.film_response import tabulate
from steradian.masks.film_attenuation import attenuation_db
from steradian.reconstructions.film_response_choice import Film, SimulatedFilmResponse
from support.flat import flat_reconstruct

SPEED, INTERVAL, SIDE, DEPTH = 1500.0, 10e-9, 6.4e-3, 1.4e-3
COMMON: dict[str, Any] = {
    "sampling_interval": INTERVAL,
    "sound_speed": SPEED,
    "aperture": SIDE,
    "modes": 80,
    "lateral_padding": 1.5,
}


def ring() -> np.ndarray:
    """Sensors that see the middle at ``DEPTH`` under 50° to 62°."""
    axis = (np.arange(80) - 40) * SIDE / 80
    points = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    angle = np.degrees(np.arctan(np.hypot(*points.T) / DEPTH))
    return points[(angle >= 50) & (angle <= 62)]


def peak(traces: np.ndarray, sensors: np.ndarray, correction: InverseFilter | None) -> float:
    volume = flat_reconstruct(traces, sensors, correction=correction, **COMMON)
    near = np.abs(volume.axes.z - DEPTH) < 0.2e-3
    return float(volume.values[38:43, 38:43, near].max())


@pytest.mark.long
def test_a_ball_seen_at_50_to_62_degrees_regains_its_amplitude_within_a_tenth() -> None:
    sensors, ball = ring(), Balls(np.array([[0.0, 0.0, DEPTH]]), np.array([90e-6]), np.array([1.0]))
    times = np.arange(400) * INTERVAL
    ideal = pressure(ball, sensors, times, SPEED)
    real = low_pass(pressure(ball, sensors, times, SPEED, directivity), INTERVAL)
    wanted = peak(ideal, sensors, None)
    assert peak(real, sensors, None) < 0.75 * wanted
    for gain in (4.0, 10.0):  # |S| is 0.42 at 62°, above 1.5 / 4
        assert peak(real, sensors, InverseFilter(SimulatedFilmResponse(), gain)) == pytest.approx(wanted, rel=0.1)


@pytest.mark.parametrize("gain", [2.0, 10.0])
def test_inverse_filter_noise_gain_is_bounded(gain: float) -> None:
    sensors = ring()
    noise = np.random.default_rng(0).standard_normal((len(sensors), 400)).astype(np.float32)
    plain = flat_reconstruct(noise, sensors, **COMMON).values
    filtered = flat_reconstruct(
        noise, sensors, correction=InverseFilter(SimulatedFilmResponse(), gain), **COMMON
    ).values
    assert 1.2 < np.linalg.norm(filtered) / np.linalg.norm(plain) <= gain
    frequencies, sines = np.linspace(0, 50e6, 60), np.linspace(0, 1, 50)
    for film in (SimulatedFilmResponse(), ElasticFilm()):
        filter_ = np.abs(InverseFilter(film, gain).evaluate(frequencies, sines, SPEED))
        response = np.abs(film.evaluate(frequencies, sines, SPEED))
        assert filter_.max() <= gain * (1 + 1e-12)
        enough = response >= 1.5 / gain
        assert (filter_ * response)[enough].min() >= 0.899


def test_an_elastic_film_at_normal_incidence_is_the_three_layer_formula() -> None:
    film = ElasticFilm(backing_speeds=(5600.0, 3300.0), backing_density=2500.0)
    f = np.linspace(0.5e6, 40e6, 30)
    k, h = 2 * np.pi * f / film.speeds[0], film.thickness
    impedance = film.density * film.speeds[0]
    below = (2500.0 * 5600.0 - impedance) / (2500.0 * 5600.0 + impedance)
    above = (film.fluid_density * SPEED - impedance) / (film.fluid_density * SPEED + impedance)
    # waves to and fro: mean pressure of the film over that at f = 0, where it is twice the backing's share
    down = 1 / (1 - above * below * np.exp(-2j * k * h))
    mean = down * (1 - np.exp(-1j * k * h)) * (1 + below * np.exp(-1j * k * h)) / (1j * k * h)
    still = (1 + below) / (1 - above * below)
    found = film.evaluate(f, np.zeros(1), SPEED)[:, 0]
    np.testing.assert_allclose(found, mean / still, rtol=1e-4)


def test_a_film_of_its_backing_s_material_is_the_half_space_under_all_angles() -> None:
    """Brekhovskikh's transmission from a fluid into an elastic half-space, beyond both critical angles as well."""
    speeds, density, h = (2700.0, 1300.0), 1180.0, 50e-6
    film = ElasticFilm(h, speeds, density, speeds, density)

    def thinning(f: float, angle: float) -> complex:
        omega = 2 * np.pi * f
        kx = omega * np.sin(angle) / SPEED
        kp, ks = (np.sqrt((omega / c) ** 2 - kx**2 + 0j) for c in speeds)
        sine, cosine = kx * speeds[1] / omega, ks * speeds[1] / omega
        double, twice = 1 - 2 * sine**2, 2 * sine * cosine
        zp, zs, z = density * omega / kp, density * omega / ks, film.fluid_density * SPEED / np.cos(angle)
        share = 2 * film.fluid_density / density / (zp * double**2 + zs * twice**2 + z)
        p, s = share * zp * double, share * zs * twice  # potentials, u = ∇p + (−∂s/∂z, ∂s/∂x)
        change = 1j * kp * p * (1 - np.exp(1j * kp * h)) + 1j * kx * s * (1 - np.exp(1j * ks * h))
        return complex(change / omega**2)

    f, angles = np.array([1e6, 5e6, 20e6]), np.radians([0.0, 15.0, 30.0, 40.0, 55.0, 75.0])
    expected = np.array([[thinning(a, b) for b in angles] for a in f]) / thinning(1e3, 0.0)
    # its time goes the other way
    np.testing.assert_allclose(film.evaluate(f, np.sin(angles), SPEED), expected.conj(), rtol=1e-3)


def test_an_elastic_film_is_deaf_where_its_longitudinal_wave_would_run_along_it() -> None:
    angles = np.radians(np.linspace(1, 60, 119))
    loss = np.abs(ElasticFilm().evaluate(np.array([2e6]), np.sin(angles), SPEED))[0]
    assert np.degrees(angles[loss.argmin()]) == pytest.approx(np.degrees(np.arcsin(SPEED / 2200)), abs=1.5)


def test_a_measured_response_is_read_between_its_points() -> None:
    film = MeasuredFilm([0.0, 10e6], np.radians([0.0, 60.0]), [[1.0, 0.5], [0.8, 0.1j]])
    found = film.evaluate(np.array([0.0, 5e6, 30e6]), np.sin(np.radians([0.0, 30.0])), SPEED)
    np.testing.assert_allclose(found, [[1.0, 0.75], [0.9, (0.75 + 0.4 + 0.05j) / 2], [0.8, 0.4 + 0.05j]])
    with pytest.raises(InvalidInput, match="gains"):
        MeasuredFilm([0.0, 1e6], [0.0], [[1.0, 1.0]])


def test_a_complex_filter_shifts_every_wave_by_its_phase() -> None:
    class Delay:
        def evaluate(self, frequencies: np.ndarray, sines: np.ndarray, sound_speed: float) -> np.ndarray:
            return np.exp(-2j * np.pi * frequencies[:, None] * 3 * INTERVAL) * np.ones(len(sines))

    sensors, ball = ring()[::4], Balls(np.array([[0.3e-3, 0.0, DEPTH]]), np.array([90e-6]), np.array([1.0]))
    times = np.arange(400) * INTERVAL
    on_time = flat_reconstruct(pressure(ball, sensors, times, SPEED), sensors, **COMMON).values
    late = pressure(ball, sensors, times - 3 * INTERVAL, SPEED)
    mended = flat_reconstruct(late, sensors, correction=InverseFilter(Delay(), 1e4), **COMMON).values
    assert np.linalg.norm(mended - on_time) < 0.02 * np.linalg.norm(on_time)


def test_the_rule_of_thumb_is_the_masks_own() -> None:
    film = Film(kind="rule").correction()
    assert film is not None
    for angle, frequency in ((0.3, 1e6), (1.0, 2e6)):
        loss = -20 * np.log10(np.abs(film.response.evaluate(np.array([frequency]), np.sin([angle]), SPEED)[0, 0]))
        assert loss == pytest.approx(attenuation_db(angle, frequency))


def test_impossible_films_are_refused_by_name() -> None:
    for field, film in (("thickness", {"thickness": 0.0}), ("speeds", {"speeds": (1000.0, 900.0)})):
        with pytest.raises(InvalidInput, match=field):
            ElasticFilm(**film)  # type: ignore[arg-type]
    with pytest.raises(InvalidInput, match="max_gain"):
        InverseFilter(SimulatedFilmResponse(), 0.5)
    with pytest.raises(InvalidInput, match="speeds"):
        Film(kind="elastic", speeds=(1.0, 2.0)).correction()
    assert Film().correction() is None
    assert tabulate(None, nyquist=1.0, bandwidth=1.0, sound_speed=1.0)[0].shape == (2, 1, 1)
