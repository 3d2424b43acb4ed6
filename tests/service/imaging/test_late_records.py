"""Records that begin late, or before the laser pulse: what was at which depth is imaged there."""

from __future__ import annotations

from math import ceil
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steradian.core.exceptions import InvalidInput
from steradian.imaging import Iterative, Volume, direct_spectrum
from steradian.imaging.engines import run_inverse
from steradian.phantoms import Balls, pressure
from support.flat import flat_fit, flat_operator, flat_plan, flat_reconstruct
from support.reference_engine import ReferenceEngine

SPEED, INTERVAL, SIDE, COUNT = 1500.0, 20e-9, 4e-3, 20
STEP = SPEED * INTERVAL
AXIS = (np.arange(COUNT) - COUNT // 2) * SIDE / COUNT
PLANE = np.stack(np.meshgrid(AXIS, AXIS, indexing="ij"), axis=-1).reshape(-1, 2)
LINE = np.linspace(-0.48, 0.48, 48) * SIDE
COMMON: dict[str, Any] = {"sampling_interval": INTERVAL, "sound_speed": SPEED, "aperture": SIDE, "modes": COUNT}
CENTRE = (0.4e-3, -0.2e-3, 5.0e-3)
RNG = np.random.default_rng(0)


def ball(samples: int, begins: float, centre: tuple[float, float, float] = CENTRE) -> np.ndarray:
    """Closed-form A-lines of one ball over the plane of sensors; ``begins`` samples after the pulse."""
    balls = Balls(np.array([centre]), np.array([0.1e-3]), np.array([1.0]))
    return pressure(
        balls, PLANE, samples=samples, sampling_interval=INTERVAL, sound_speed=SPEED, time_zero=begins * INTERVAL
    )


def peak(volume: Volume) -> tuple[float, ...]:
    """Place of the brightest voxel."""
    found = np.unravel_index(volume.values.argmax(), volume.values.shape)
    return tuple(float(volume.coordinates(name)[n]) for name, n in zip(volume.names, found, strict=True))


def apart(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest difference over the largest value."""
    return float(np.abs(found - expected).max() / np.abs(expected).max())


@pytest.mark.parametrize("method", ["nedner", "ner", "linear", "nearest", "interpolated"])
def test_late_record_shows_the_ball_at_its_depth_and_amplitude(method: Any) -> None:
    late = flat_reconstruct(ball(150, 150), PLANE, time_zero=3e-6, method=method, **COMMON)
    assert late.axes.z[0] == pytest.approx(4.5e-3)
    assert late.axes.z[-1] == pytest.approx(9.0e-3 - STEP)
    np.testing.assert_allclose(peak(late), CENTRE, atol=1.01 * max(late.spacing[0] / 2, STEP))
    whole = flat_reconstruct(ball(300, 0), PLANE, **COMMON)
    assert late.values.max() == pytest.approx(whole.values.max(), rel=0.05)


@pytest.mark.parametrize("engine", ["numba", "array"])
@pytest.mark.parametrize("positions", [PLANE, LINE], ids=["plane", "line"])
@pytest.mark.parametrize("begins", [60, *(pytest.param(begins, marks=pytest.mark.long) for begins in (7, 333))])
def test_late_record_gives_the_image_of_the_record_filled_with_zeros(positions: Any, begins: int, engine: str) -> None:
    traces = RNG.standard_normal((len(positions), 64))
    filled = np.concatenate([np.zeros((len(positions), begins)), traces], axis=1)
    options: dict[str, Any] = {**COMMON, "tolerance": 1e-8}

    def image(lines: np.ndarray, **more: Any) -> np.ndarray:
        plan = flat_plan(positions, samples=lines.shape[1], **{**options, **more})
        made = plan.run(lines).values if engine == "numba" else run_inverse(ReferenceEngine(plan.tables), lines)
        return np.asarray(made)

    expected, zero = image(filled), begins * INTERVAL
    from_film = image(traces, time_zero=zero, depth_range=(0.0, (begins + 63) * STEP))
    assert apart(from_film, expected) < 1e-6
    usual = image(traces, time_zero=zero)
    assert usual.shape[-1] == (71 if begins == 7 else 64)
    assert apart(usual, expected[..., -usual.shape[-1] :]) < 1e-6


def test_late_record_on_the_gpu_engine_is_that_of_the_array_engine(cuda: Any) -> None:
    options = {**COMMON, "modes": 6, "tolerance": 1e-2, "dtype": "float64"}
    plan = flat_plan(PLANE[::40], samples=16, time_zero=31 * INTERVAL, **options)
    traces = RNG.standard_normal((len(PLANE[::40]), 16))
    engine = cuda(plan.tables)
    assert apart(engine.host(run_inverse(engine, traces)), run_inverse(ReferenceEngine(plan.tables), traces)) < 1e-12


@pytest.mark.long
@settings(max_examples=12, deadline=None)
@given(
    begins=st.one_of(st.floats(-40, 200), st.integers(-40, 200)), padding=st.sampled_from([1.0, 1.5]),
    ends=st.tuples(st.floats(0, 1), st.floats(0, 1)),
)  # fmt: skip
def test_any_time_zero_and_depth_range_gives_the_direct_sums(
    begins: float, padding: float, ends: tuple[float, float]
) -> None:
    traces = np.random.default_rng(1).standard_normal((len(LINE), 48))
    options = {**COMMON, "modes": 21, "tolerance": 1e-6, "dtype": "float64"}
    zero, whole = begins * INTERVAL, int(np.ceil(round(begins, 6)))
    first, last = sorted(int(share * (47 + whole)) for share in ends)
    plan = flat_plan(LINE, samples=48, time_zero=zero, time_padding=padding, **options)
    record = plan.geometry.record
    assert record >= 48 + begins - 1e-6
    found = flat_reconstruct(
        traces, LINE, time_zero=zero, time_padding=padding, depth_range=(first * STEP, last * STEP), **options
    )
    np.testing.assert_allclose(found.axes.z, np.arange(first, last + 1) * STEP, atol=1e-12)
    j, l = np.meshgrid(np.arange(-10, 11), np.arange((record + 1) // 2), indexing="ij")  # noqa: E741
    sums = direct_spectrum(traces, LINE, j.ravel(), l.ravel(), record=record, time_zero=zero, **COMMON | {"modes": 21})
    spectrum = np.fft.ifft(np.fft.ifftshift(sums.reshape(j.shape), axes=0), axis=0)
    image = np.fft.fftshift(np.fft.irfft(spectrum, record, axis=1), axes=0)
    assert np.abs(found.values - image[:, first : last + 1]).max() < 1e-5 * np.abs(image).max()


@pytest.mark.long
@settings(max_examples=12, deadline=None)
@given(begins=st.integers(0, 300), ends=st.tuples(st.floats(0, 1), st.floats(0, 1)))
def test_any_depth_range_of_a_late_record_is_that_of_the_zero_filled_one(
    begins: int, ends: tuple[float, float]
) -> None:
    traces, options = np.random.default_rng(1).standard_normal((len(LINE), 48)), {**COMMON, "tolerance": 1e-7}
    low, high = sorted(share * (47 + begins) * STEP for share in ends)
    high += STEP if high + STEP <= (47 + begins) * STEP else 0.0
    low = min(low, high - STEP) if high >= STEP else 0.0
    late = flat_reconstruct(traces, LINE, time_zero=begins * INTERVAL, depth_range=(low, high), **options)
    filled = np.concatenate([np.zeros((len(LINE), begins)), traces], axis=1)
    expected = flat_reconstruct(filled, LINE, depth_range=(low, high), **options)
    np.testing.assert_array_equal(late.axes.z, expected.axes.z)
    scale = np.abs(flat_reconstruct(filled, LINE, **options).values).max()
    assert np.abs(late.values - expected.values).max() < 1e-6 * scale


def test_object_nearer_than_the_record_has_no_copy_at_another_depth() -> None:
    """Sensors far to its side hear a ball at 3.2 mm after 3 µs; its image lies at 3.2 mm and not a record deeper."""
    near = ball(150, 150, (0.0, 0.0, 3.2e-3))
    assert np.abs(near).max() > 1e-3 * np.abs(ball(300, 0, (0.0, 0.0, 3.2e-3))).max()
    image = flat_reconstruct(near, PLANE, time_zero=3e-6, depth_range=(0.0, 8.9e-3), **COMMON)
    assert peak(image)[-1] < 4.5e-3
    usual = flat_reconstruct(near, PLANE, time_zero=3e-6, **COMMON)
    np.testing.assert_allclose(usual.values[..., :147], image.values[..., 150:], atol=1e-5 * image.values.max())
    assert usual.values.max() < 0.5 * image.values.max()


@pytest.mark.parametrize(
    ("begins", "first", "last"),
    [
        (0, 0, 100),
        (1, 0, 101),
        (25, 0, 125),
        (26, 26, 126),
        (400, 400, 500),
        (-10, 0, 90),
        (-0.5, 0, 100),
        (25.5, 26, 126),
    ],
)
def test_usual_depths_reach_to_the_record_s_end_and_from_the_film_or_a_late_record_s_begin(
    begins: float, first: int, last: int
) -> None:
    plan = flat_plan(LINE, samples=100, time_zero=begins * INTERVAL, **COMMON)
    assert plan.geometry.depth == (first, last)
    np.testing.assert_allclose(plan.geometry.axes().z[[0, -1]], [first * STEP, (last - 1) * STEP])


def test_usual_depths_with_fewer_slices_or_padding_are_the_same() -> None:
    for more in ({"highest_frequency": 5e6}, {"depth_step": 45e-6, "highest_frequency": 5e6}, {"time_padding": 2.0}):
        z = flat_reconstruct(ball(150, 150), PLANE, time_zero=3e-6, **COMMON, **more).axes.z
        step = z[1] - z[0]
        assert 4.5e-3 - 1e-9 <= z[0] < 4.5e-3 + step
        assert 9e-3 - step - 1e-9 <= z[-1] < 9e-3
    image = flat_reconstruct(ball(150, 150), PLANE, time_zero=3e-6, highest_frequency=9e6, **COMMON)
    np.testing.assert_allclose(peak(image), CENTRE, atol=1.01 * max(image.spacing[0] / 2, image.spacing[-1]))


def test_record_from_before_the_pulse_shows_the_ball_and_ends_where_it_ends() -> None:
    centre = (0.2e-3, 0.2e-3, 2.0e-3)
    early = flat_reconstruct(ball(150, -50, centre), PLANE, time_zero=-1e-6, **COMMON)
    assert early.values.shape[-1] == 100
    whole = flat_reconstruct(ball(150, 0, centre), PLANE, time_padding=1.5, **COMMON)
    np.testing.assert_allclose(peak(early), peak(whole))
    with pytest.raises(InvalidInput, match=r"within 0 … 0\.003$"):
        flat_reconstruct(ball(150, -50), PLANE, time_zero=-1e-6, depth_range=(0.0, 4e-3), **COMMON)


def test_depth_range_of_a_late_record_may_reach_to_its_last_sample() -> None:
    image = flat_reconstruct(ball(150, 150), PLANE, time_zero=3e-6, depth_range=(7e-3, 9e-3), **COMMON)
    assert image.axes.z[-1] == pytest.approx(299 * STEP)
    with pytest.raises(InvalidInput, match=r"within 0 … 0\.009$"):
        flat_reconstruct(ball(150, 150), PLANE, time_zero=3e-6, depth_range=(7e-3, 9.5e-3), **COMMON)


@pytest.mark.parametrize("zero", [0.5, -0.5, 3.0, 500.0, 1e-3])
def test_time_zero_in_another_unit_is_refused_with_its_range(zero: float) -> None:
    with pytest.raises(InvalidInput, match=r"at least -0\.0005, at most 0\.0005 \(s\)") as refused:
        flat_reconstruct(ball(150, 0), PLANE, time_zero=zero, **COMMON)
    assert refused.value.field == "t0"


def test_record_that_ends_before_the_pulse_is_refused() -> None:
    with pytest.raises(InvalidInput, match=r"t0 is -3e-06; allowed: at least -2\.96e-06 \(s\).*150 samples"):
        flat_reconstruct(ball(150, -150), PLANE, time_zero=-3e-6, **COMMON)


@pytest.mark.parametrize("positions", [PLANE, LINE], ids=["plane", "line"])
@pytest.mark.parametrize("begins", [-11.5, 40.0, 150.25])
def test_model_of_a_late_record_and_its_transpose_agree(positions: Any, begins: float) -> None:
    model = flat_operator(
        positions, samples=64, time_zero=begins * INTERVAL, dtype="float64", lateral_padding=1.5, **COMMON
    )
    volume, traces = RNG.standard_normal(model.volume_shape), RNG.standard_normal(model.trace_shape)
    forward, backward = model.forward(volume), model.backward(traces)
    assert np.vdot(forward, traces) == pytest.approx(np.vdot(volume, backward), rel=1e-10)


def test_model_of_a_late_record_sounds_like_the_ball() -> None:
    model = flat_operator(PLANE, samples=150, time_zero=3e-6, **COMMON | {"modes": 40})
    axes = model.geometry.axes()
    assert axes.y is not None
    x, y, z = np.meshgrid(axes.x, axes.y, axes.z, indexing="ij")
    squares = (x - CENTRE[0]) ** 2 + (y - CENTRE[1]) ** 2 + (z - CENTRE[2]) ** 2
    found = model.forward(np.exp(-squares / (2 * 0.1e-3**2)))
    assert apart(found, ball(150, 150)) < 0.02


def test_iterative_image_of_a_late_record_has_the_ball_at_its_place() -> None:
    options = Iterative("none", iterations=6)
    found = flat_fit(ball(150, 150), PLANE, time_zero=3e-6, options=options, **COMMON)
    assert found.axes.z[[0, -1]] == pytest.approx([4.5e-3, 9e-3 - STEP])
    np.testing.assert_allclose(peak(found), CENTRE, atol=1.01 * max(found.spacing[0] / 2, STEP))
    early = ball(150, -40, (0.2e-3, 0.2e-3, 0.6e-3))
    found = flat_fit(early, PLANE, time_zero=-0.8e-6, options=options, **COMMON)
    np.testing.assert_allclose(peak(found), (0.2e-3, 0.2e-3, 0.6e-3), atol=2 * STEP)


def test_iterative_image_leaves_out_samples_before_the_pulse() -> None:
    traces, options = RNG.standard_normal((len(LINE), 64)), Iterative("none", iterations=2)
    picked_up = traces.copy()
    picked_up[:, :20] += 30.0
    clean, disturbed = (
        flat_fit(lines, LINE, time_zero=-20 * INTERVAL, options=options, **COMMON) for lines in (traces, picked_up)
    )
    np.testing.assert_array_equal(clean.values, disturbed.values)


def test_iterative_image_of_late_record_models_shallower_sources() -> None:
    """Sound that sensors to the side hear of a ball at 3.9 mm is explained by it, though the image begins at 4.5 mm."""
    near, options = ball(150, 150, (0.0, 0.0, 3.9e-3)), Iterative("tikhonov", iterations=8)
    usual = flat_fit(near, PLANE, time_zero=3e-6, options=options, **COMMON)
    whole = flat_fit(near, PLANE, time_zero=3e-6, options=options, depth_range=(0.0, 299 * STEP), **COMMON)
    np.testing.assert_allclose(peak(whole), (0.0, 0.0, 3.9e-3), atol=2.01 * STEP)
    end = ceil(np.sqrt(np.prod(np.ptp(PLANE, axis=0)) / len(PLANE)) / 2 / STEP)  # where one sensor alone hears it
    np.testing.assert_allclose(usual.values[..., :-end], whole.values[..., 150:-end], atol=1e-3 * whole.values.max())
    assert usual.values.max() < 0.2 * whole.values.max()


def test_model_of_a_record_many_records_late_is_refused_by_its_time_zero() -> None:
    with pytest.raises(InvalidInput, match="t0 is") as refused:
        flat_operator(LINE, samples=64, time_zero=1000 * INTERVAL, lateral_padding=1.0, **COMMON)
    assert refused.value.field == "t0"
