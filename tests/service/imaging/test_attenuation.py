"""Attenuation: power law with dispersion, A-lines attenuated by a matrix, images that get back what it took.

A-lines are simulated in closed form for each frequency, which the reconstruction does not know.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

from steradian.core.exceptions import InvalidInput
from steradian.imaging import (
    ATTENUATIONS,
    Acquisition,
    AcquisitionGeometry,
    Attenuation,
    Compute,
    ImageGrid,
    Iterative,
    Layer,
    Medium,
    ReconstructionPlan,
    Volume,
    reconstruct,
)
from steradian.imaging.incremental import IncrementalReconstruction
from steradian.imaging.operators import ForwardOperator
from steradian.imaging.signal.attenuation import Compensation, attenuation_matrix
from steradian.masks import equi_steradian_mask
from steradian.phantoms import Balls, add_noise, initial_pressure, layered_pressure

TISSUE = Medium([Layer(1500.0, attenuation=ATTENUATIONS["soft tissue"])])
LAYERS = Medium(
    [
        Layer(1480.0, 2e-3, 1000.0, ATTENUATIONS["water"]),
        Layer(1580.0, None, 1000.0, ATTENUATIONS["soft tissue"]),
    ]
)  # fmt: skip
CPU = Compute(device="cpu")
DT, SAMPLES = 20e-9, 240
MASK = equi_steradian_mask(8e-3, 3e-3, 300)
CENTRES = np.array([(0.4e-3, 0.3e-3, 1.2e-3), (-0.5e-3, 0.2e-3, 3.0e-3), (0.2e-3, -0.6e-3, 4.4e-3)])
BALLS = Balls(CENTRES, np.full(3, 70e-6), np.ones(3))


def simulate(medium: Medium, balls: Balls = BALLS, time_zero: float = 0.0, samples: int = SAMPLES) -> np.ndarray:
    return layered_pressure(
        balls, MASK.positions, medium, samples=samples, sampling_interval=DT, time_zero=time_zero
    )  # fmt: skip


def test_absorption_is_the_power_law_in_nepers() -> None:
    decibels = 20 * np.log10(np.exp(ATTENUATIONS["soft tissue"].absorption([1e6, 4e6]) * 1e-2))
    np.testing.assert_allclose(decibels, [0.75, 6.0], rtol=1e-12)
    np.testing.assert_allclose(ATTENUATIONS["water"].absorption(1e6), 0.025, rtol=2e-3)  # Np/m, 25e-15 s²/m


@pytest.mark.parametrize("power", [0.6, 1.0, 1.0001, 1.5, 2.0, 2.4])
def test_dispersion_is_the_kramers_kronig_integral(power: float) -> None:
    """Once-subtracted relation for 1/c, as a principal value: 2/π ∫ α(w)·(1/(w² − ω²) − 1/(w² − ω₀²)) dw."""
    law, ratio = Attenuation(0.5, power), 6.0

    def weight(x: float) -> float:
        return x**power * (ratio**2 - 1)

    # in units of ω₀ = 2π·1 MHz, the poles at 1 and at 6
    low = quad(lambda x: weight(x) / (x**2 - ratio**2) / (x + 1), 0, 3, weight="cauchy", wvar=1.0)[0]
    middle = quad(lambda x: weight(x) / (x**2 - 1) / (x + ratio), 3, 12, weight="cauchy", wvar=ratio)[0]
    high = quad(lambda x: weight(x) / (x**2 - 1) / (x**2 - ratio**2), 12, np.inf)[0]
    omega = 2 * np.pi * 1e6
    expected = 2 / np.pi * float(law.absorption(1e6)) / omega * (low + middle + high)
    assert float(law.excess(ratio * 1e6).real) / (ratio * omega) == pytest.approx(expected, rel=1e-6, abs=1e-15)
    assert float(law.excess(1e6).real) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("power", [0.6, 1.0, 1.5, 2.4])
def test_continued_decay_is_analytic(power: float) -> None:
    law, s, step = Attenuation(0.5, power), 2e6 + 3e7j, 1e2
    along, across = (complex(law.decay(s + step * d) - law.decay(s - step * d)) / (2 * step * d) for d in (1, 1j))
    assert abs(along - across) <= 1e-6 * abs(along)  # Cauchy–Riemann equations


@pytest.mark.parametrize("time_zero", [0.0, 53.4 * DT], ids=["from the pulse", "late"])
def test_matrix_attenuates_a_lines_as_the_closed_form(time_zero: float) -> None:
    balls = Balls(CENTRES[1:], np.full(2, 70e-6), np.ones(2))  # heard after the late record's begin
    clean, truth = (simulate(each, balls, time_zero) for each in (TISSUE.lossless, TISSUE))
    matrix = attenuation_matrix(TISSUE, samples=SAMPLES, interval=DT, time_zero=time_zero)
    assert np.linalg.norm(clean - truth) > 0.2 * np.linalg.norm(truth)
    assert np.linalg.norm(clean @ matrix.T - truth) <= 1e-5 * np.linalg.norm(truth)


def test_matrix_of_a_layer_is_near_the_attenuation_along_rays() -> None:
    matrix = attenuation_matrix(LAYERS, samples=SAMPLES, interval=DT, time_zero=0.0)
    for centre, most in zip(CENTRES[1:], (0.06, 0.03), strict=True):
        balls = Balls(centre[None], np.array([70e-6]), np.ones(1))
        clean, truth = simulate(LAYERS.lossless, balls), simulate(LAYERS, balls)
        assert np.linalg.norm(clean @ matrix.T - truth) <= most * np.linalg.norm(truth)


@pytest.mark.parametrize(("dtype", "most"), [("float32", 1e-6), ("float64", 1e-14)])
@pytest.mark.parametrize("medium", [TISSUE, LAYERS], ids=["one medium", "layers"])
def test_both_products_with_attenuation_agree_to_rounding(medium: Medium, dtype: str, most: float) -> None:
    rng = np.random.default_rng(0)
    geometry = AcquisitionGeometry(rng.uniform(-1e-3, 1e-3, (25, 2)), 90, dt=40e-9, medium=medium, aperture=2e-3)
    compute = Compute(device="cpu", dtype=dtype)
    operator = ForwardOperator(geometry, ImageGrid(8, depth=(0.5e-3, 4e-3)), compute=compute)
    volume, traces = rng.standard_normal(operator.volume_shape), rng.standard_normal(operator.trace_shape)
    there, back = (each.astype(np.float64) for each in (operator.forward(volume), operator.backward(traces)))
    assert abs(np.vdot(there, traces) - np.vdot(volume, back)) <= most * np.linalg.norm(there) * np.linalg.norm(traces)


@pytest.mark.long
@pytest.mark.parametrize("medium", [TISSUE, LAYERS], ids=["one medium", "layers"])
def test_model_with_attenuation_gives_the_a_lines_of_the_closed_form(medium: Medium) -> None:
    geometry = AcquisitionGeometry(MASK, SAMPLES, dt=DT, medium=medium)
    operator = ForwardOperator(geometry, ImageGrid(136, depth=(0.6e-3, 5.2e-3)), compute=CPU)
    axes = operator.geometry.axes()
    assert axes.y is not None
    for centre in CENTRES:
        balls = Balls(centre[None], np.array([70e-6]), np.ones(1))
        found, truth = operator.forward(initial_pressure(balls, axes.x, axes.y, axes.z)), simulate(medium, balls)
        assert np.linalg.norm(found - truth) <= 6e-3 * np.linalg.norm(truth)


def noisy(medium: Medium, decibels: float = 30.0) -> np.ndarray:
    return add_noise(simulate(medium), decibels)


@lru_cache
def image(acquired: Medium, imaged_as: Medium, *, noise: bool = True, late: int = 0) -> Volume:
    traces = (noisy(acquired) if noise else simulate(acquired))[:, late:]
    acquisition = Acquisition(traces, MASK, dt=DT, t0=late * DT, medium=imaged_as)
    return reconstruct(acquisition, ImageGrid(modes=136, depth=(0.8e-3, 5.0e-3)), compute=CPU)


def ball_image(volume: Volume, centre: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Largest value near a ball, its place by a parabola and the widths at half of it."""
    axes = [volume.coordinates(name) for name in volume.names]
    at = [int(np.abs(axis - c).argmin()) for axis, c in zip(axes, centre, strict=True)]
    reach = [max(4, int(120e-6 / step)) for step in volume.spacing]
    near = volume.values[tuple(slice(i - r, i + r + 1) for i, r in zip(at, reach, strict=True))]
    top = np.array(np.unravel_index(near.argmax(), near.shape)) + np.array(at) - reach
    place, widths = [], []
    for axis, (i, step) in enumerate(zip(top, volume.spacing, strict=True)):
        line = np.moveaxis(volume.values, axis, 0)[(slice(None), *np.delete(top, axis))].astype(float)
        before, here, after = line[i - 1 : i + 2]
        place.append(axes[axis][i] + step * 0.5 * (before - after) / (before - 2 * here + after))
        ends = [next(n for n in range(60) if line[i + sign * n] < here / 2) for sign in (-1, 1)]
        parts = [
            n - (here / 2 - line[i + sign * n]) / (line[i + sign * (n - 1)] - line[i + sign * n])
            for n, sign in zip(ends, (-1, 1), strict=True)
        ]
        widths.append(sum(parts) * step)
    return float(volume.values[tuple(top)]), np.array(place), np.array(widths)


@pytest.mark.parametrize("medium", [TISSUE, LAYERS], ids=["one medium", "layers"])
def test_compensated_image_has_place_width_and_amplitude_of_the_lossless_one(medium: Medium) -> None:
    plain, restored = image(medium.lossless, medium.lossless), image(medium, medium)
    taken = image(medium, medium.lossless)
    for centre in CENTRES:
        value, _, widths = ball_image(plain, centre)
        found, place, width = ball_image(restored, centre)
        assert found >= 0.92 * value
        np.testing.assert_array_less(np.abs(place - centre), restored.spacing)
        np.testing.assert_allclose(width, widths, rtol=0.1)
    assert ball_image(taken, CENTRES[2])[0] < 0.8 * ball_image(plain, CENTRES[2])[0]


def test_late_record_is_compensated_for_the_whole_way() -> None:
    late = image(TISSUE, TISSUE, late=100)
    found, expected = (ball_image(each, CENTRES[2])[0] for each in (late, image(TISSUE, TISSUE)))
    assert found == pytest.approx(expected, rel=0.05)


def test_noise_gain_is_the_noise_of_compensated_a_lines_and_in_the_image_s_report() -> None:
    traces, white = noisy(TISSUE), np.random.default_rng(0).standard_normal((20_000, SAMPLES))
    found = Compensation(TISSUE, samples=SAMPLES, interval=DT, time_zero=0.0).restoration(traces)
    np.testing.assert_allclose((white @ found.matrix.T).std(axis=0), found.noise_gain, rtol=0.03)
    assert found.noise_gain[200] > 3 * found.noise_gain[60]
    info = image(TISSUE, TISSUE).info
    assert info is not None
    depths, gains = np.array(info.noise_gain).T
    np.testing.assert_allclose(gains, np.interp(depths / 1500.0 / DT, np.arange(SAMPLES), found.noise_gain), rtol=1e-6)
    assert any("attenuation was compensated, with a noise gain of" in note for note in info.notes)


def test_noisier_records_are_amplified_less() -> None:
    compensation = Compensation(TISSUE, samples=SAMPLES, interval=DT, time_zero=0.0)
    gains = [compensation.restoration(noisy(TISSUE, each)).noise_gain[200] for each in (40.0, 30.0, 20.0)]
    assert gains == sorted(gains, reverse=True)


def test_record_without_signal_or_without_noise_is_imaged() -> None:
    plan = ReconstructionPlan(AcquisitionGeometry(MASK, SAMPLES, dt=DT, medium=TISSUE), ImageGrid(16), compute=CPU)
    for traces in (np.zeros((MASK.count, SAMPLES)), np.zeros((MASK.count, SAMPLES), np.int16), simulate(TISSUE)):
        volume = plan.run(traces)
        assert isinstance(volume, Volume)
        assert np.isfinite(volume.values).all()


@pytest.mark.long
def test_soft_tissue_takes_and_compensation_gives_back_what_is_stated() -> None:
    """Balls of 50 µm at 2, 4, 6 and 8 mm, 1,605 points, 30 dB; the mean of four noises."""
    interval, samples = 8e-9, 1200
    centres = np.array(
        [(-0.9e-3, 0.3e-3, 2e-3), (0.8e-3, 0.5e-3, 4e-3), (0.3e-3, -0.9e-3, 6e-3), (-0.4e-3, -0.2e-3, 8e-3)]
    )
    balls = Balls(centres, np.full(4, 50e-6), np.ones(4))
    mask = equi_steradian_mask(13.56e-3, 3.6e-3, 1600)
    images = {}
    for medium in (TISSUE.lossless, TISSUE):
        traces = layered_pressure(balls, mask.positions, medium, samples=samples, sampling_interval=interval)
        geometry = AcquisitionGeometry(mask, samples, dt=interval, medium=medium)
        plan = ReconstructionPlan(geometry, ImageGrid(226, depth=(1e-3, 9e-3)), compute=CPU)
        volumes = [plan.run(add_noise(traces, 30.0, seed=seed)) for seed in range(4)]
        images[medium.lossy] = [[ball_image(each, centre) for each in volumes] for centre in centres]  # type: ignore[arg-type]
        spacing = plan.geometry.spacing
    shares = (0.95, 0.92, 0.90, 0.85)
    for centre, plain, restored, share in zip(centres, images[False], images[True], shares, strict=True):
        value, _, widths = (np.mean([each[i] for each in plain], axis=0) for i in range(3))
        found, place, width = (np.mean([each[i] for each in restored], axis=0) for i in range(3))
        assert found >= share * value
        np.testing.assert_array_less(np.abs(place - centre), spacing)
        np.testing.assert_allclose(width, widths, rtol=0.1)


@pytest.mark.long
@pytest.mark.parametrize("medium", [TISSUE, LAYERS], ids=["one medium", "layers"])
def test_iterative_image_with_the_matrix_is_better_than_the_filter(medium: Medium) -> None:
    grid = ImageGrid(modes=136, depth=(0.8e-3, 5.0e-3))
    fitted = reconstruct(Acquisition(noisy(medium), MASK, dt=DT, medium=medium), grid, Iterative(), compute=CPU)
    direct = image(medium, medium)
    axes = fitted.axes
    assert axes.y is not None
    truth = initial_pressure(BALLS, axes.x, axes.y, axes.z)
    errors = [np.linalg.norm(each.values - truth) / np.linalg.norm(truth) for each in (fitted, direct)]
    assert errors[0] < 0.8 * errors[1]


@pytest.mark.long
def test_fit_by_gradients_gives_back_what_attenuation_took() -> None:
    grid, options = ImageGrid(modes=68, depth=(0.8e-3, 5.0e-3)), Iterative(regularisation="total-variation")
    peaks = []
    for imaged_as in (TISSUE, TISSUE.lossless):
        acquisition = Acquisition(noisy(TISSUE), MASK, dt=DT, medium=imaged_as)
        peaks.append(ball_image(reconstruct(acquisition, grid, options, compute=CPU), CENTRES[2])[0])
    assert peaks[0] > 1.25 * peaks[1]


def test_memory_of_the_inverse_is_checked_before_anything_is_taken() -> None:
    geometry = AcquisitionGeometry(MASK, 20_000, dt=1e-9, medium=TISSUE)
    with pytest.raises(InvalidInput, match="memory_limit"):
        ReconstructionPlan(geometry, ImageGrid(4, depth=(0.0, 1e-4)), compute=Compute(device="cpu", memory_limit=10**9))


@pytest.mark.parametrize(
    ("make", "field", "allowed"),
    [
        (lambda: Attenuation(-0.1, 1.5), "coefficient", "at least 0, at most 100"),
        (lambda: Attenuation(0.75, 3.5), "power", "at least 0, at most 2.9"),
        (lambda: Attenuation(0.75, -0.5), "power", "at least 0, at most 2.9"),
        (lambda: Layer(1500.0, attenuation=0.75), "attenuation", "an Attenuation, or None"),  # type: ignore[arg-type]
        (lambda: IncrementalReconstruction(_plan()), "medium", "one without attenuation"),
        (lambda: _plan().run(np.full((MASK.count, SAMPLES), np.nan)), "traces", "finite numbers"),
    ],
)
def test_wrong_attenuation_is_refused_with_field_and_range(make: Any, field: str, allowed: str) -> None:
    with pytest.raises(InvalidInput) as refused:
        make()
    assert refused.value.field == field
    assert allowed in str(refused.value)


def _plan() -> ReconstructionPlan:
    return ReconstructionPlan(AcquisitionGeometry(MASK, SAMPLES, dt=DT, medium=TISSUE), ImageGrid(16), compute=CPU)
