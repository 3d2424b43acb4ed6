"""Frequencies above a limit are left out: what is below is as exact as without, and costs its share."""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pytest

from steradian.core.exceptions import InvalidInput
from steradian.imaging import Iterative, Volume, direct_spectrum, spectrum_of
from steradian.imaging.engines import run_inverse
from steradian.imaging.incremental import IncrementalReconstruction
from steradian.imaging.signal.bandwidth import power_fraction_above
from steradian.imaging.transforms.decimation import plan_decimation
from steradian.masks import equi_steradian_mask
from support.flat import flat_plan, flat_reconstruct
from support.reference_engine import ReferenceEngine

SIDE, INTERVAL, SPEED = 0.01, 8e-9, 1500.0
COMMON: dict[str, Any] = {"sampling_interval": INTERVAL, "sound_speed": SPEED, "aperture": SIDE}


def _grid(count: int) -> np.ndarray:
    axis = (np.arange(count) - count // 2) * SIDE / count
    return np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)


def _image(positions: np.ndarray, traces: np.ndarray, **options: Any) -> Volume:
    volume = flat_plan(positions, samples=traces.shape[1], **COMMON, **options).run(traces)
    assert isinstance(volume, Volume)
    return volume


@pytest.mark.long
@pytest.mark.parametrize(
    ("places", "modes", "samples", "highest", "options"),
    [
        ("anywhere", (24, 18), 300, 20e6, {}),
        ("anywhere", (23, 17), 101, 15e6, {"time_zero": 3.3e-8, "tolerance": 1e-7}),
        ("anywhere", (24, 18), 128, 20e6, {"time_padding": 1.5}),
        ("grid", (24, 24), 200, 10e6, {}),
        ("line", (64,), 512, 20e6, {}),
        ("anywhere", (24, 18), 300, 50e6, {}),  # too little is left out for fewer samples to pay
    ],
)
def test_band_limited_spectrum_matches_direct_sums(
    places: str, modes: tuple[int, ...], samples: int, highest: float, options: dict[str, Any]
) -> None:
    rng = np.random.default_rng(0)
    positions = _grid(12) if places == "grid" else (rng.random((60, len(modes))) - 0.5) * SIDE
    traces = rng.standard_normal((len(positions), samples))
    plan = flat_plan(positions, samples=samples, modes=modes, highest_frequency=highest, **COMMON, **options)
    record = plan.geometry.record
    end = (0.0, (record - 1) * INTERVAL * SPEED)
    image = _image(positions, traces, modes=modes, highest_frequency=highest, depth_range=end, **options).values
    slices = image.shape[-1]
    assert slices == plan.geometry.depth_points
    l = rng.integers(1, slices // 2, 400)  # noqa: E741
    j = np.stack([rng.integers(-(n // 2), (n + 1) // 2, 400) for n in modes], axis=1)
    exact = direct_spectrum(
        traces, positions, j, l, modes=modes, record=record, weights=plan.geometry.weights,
        time_zero=options.get("time_zero", 0.0), **COMMON,
    )  # fmt: skip
    period = record * INTERVAL
    exact[np.sqrt(l**2 + ((period * SPEED / SIDE * j) ** 2).sum(axis=1)) >= highest * period] = 0
    found = spectrum_of(image, j, l) * (record / slices)
    assert np.linalg.norm(found - exact) <= options.get("tolerance", 1e-4) * np.linalg.norm(exact)


def test_band_limited_image_equals_filtered_full_image() -> None:
    rng = np.random.default_rng(1)
    positions, traces = (rng.random((80, 2)) - 0.5) * SIDE, rng.standard_normal((80, 256))
    whole = _image(positions, traces, modes=24)
    spectrum = np.fft.rfftn(whole.values.astype(np.float64))
    j = np.fft.fftfreq(24, 1 / 24)
    cycles = np.sqrt(
        np.arange(129) ** 2 + (256 * INTERVAL * SPEED / SIDE) ** 2 * (j[:, None, None] ** 2 + j[:, None] ** 2)
    )
    spectrum[cycles >= 20e6 * 256 * INTERVAL] = 0
    expected = np.fft.irfftn(spectrum, whole.values.shape, axes=(0, 1, 2))
    fine = _image(positions, traces, modes=24, highest_frequency=20e6, depth_step=INTERVAL * SPEED)
    np.testing.assert_allclose(fine.axes.z, whole.axes.z)
    assert np.linalg.norm(fine.values - expected) <= 1e-4 * np.linalg.norm(expected)
    coarse = _image(positions, traces, modes=24, highest_frequency=20e6)
    assert coarse.spacing[-1] == pytest.approx(whole.spacing[-1] * 256 / coarse.values.shape[-1])
    assert coarse.values.shape[-1] < 0.4 * 256
    again = np.fft.irfft(np.fft.rfft(coarse.values, axis=-1), 256, axis=-1) * (256 / coarse.values.shape[-1])
    assert np.linalg.norm(again - expected) <= 1e-4 * np.linalg.norm(expected)
    part = _image(positions, traces, modes=24, highest_frequency=20e6, depth_range=(1e-3, 2e-3))
    inside = (coarse.axes.z >= 1e-3) & (coarse.axes.z <= 2e-3)
    np.testing.assert_allclose(part.axes.z, coarse.axes.z[inside])
    np.testing.assert_allclose(part.values, coarse.values[..., inside], atol=1e-5 * float(np.abs(expected).max()))


@pytest.mark.long
@pytest.mark.parametrize("method", ["linear", "nearest", "interpolated"])
def test_the_other_methods_leave_out_the_same(method: str) -> None:
    rng = np.random.default_rng(2)
    positions, traces = (rng.random((80, 2)) - 0.5) * SIDE, rng.standard_normal((80, 128))
    options: dict[str, Any] = {"modes": 24, "method": method}
    whole = np.fft.rfftn(_image(positions, traces, **options).values)
    part = np.fft.rfftn(_image(positions, traces, highest_frequency=20e6, **options).values)
    count = int(20e6 * 128 * INTERVAL)
    lowest = np.abs(np.fft.fftfreq(24, 1 / 24)) <= 2  # κ hardly differs from l there
    found, expected = (v[lowest][:, lowest][..., 1 : count - 1] for v in (part, whole))
    found = (
        found
        * (whole.shape[-1] - 1)
        * 2
        / flat_plan(positions, samples=128, highest_frequency=20e6, **COMMON, **options).geometry.depth_points
    )
    assert np.linalg.norm(found - expected) <= 2e-4 * np.linalg.norm(expected)


def test_both_engines_agree_and_an_image_that_grows_is_the_same() -> None:
    rng = np.random.default_rng(3)
    positions, traces = (rng.random((60, 2)) - 0.5) * SIDE, rng.standard_normal((60, 200)).astype(np.float32)
    plan = flat_plan(positions, samples=200, modes=24, highest_frequency=20e6, **COMMON)
    found = plan.run(traces)
    assert isinstance(found, Volume)
    expected = run_inverse(ReferenceEngine(plan.tables), plan.decimate(traces))
    assert np.linalg.norm(found.values - expected) <= 1e-5 * np.linalg.norm(expected)
    growing = IncrementalReconstruction(plan)
    growing.add(np.arange(40), traces[:40])
    growing.add(np.arange(40, 60), traces[40:])
    np.testing.assert_allclose(growing.volume().values, found.values, atol=1e-5 * float(np.abs(expected).max()))


@pytest.mark.long
@pytest.mark.timeout(900)
def test_at_full_size_it_is_the_array_engines() -> None:
    mask = equi_steradian_mask(13.56e-3, 3.6e-3, 1600)
    plan = flat_plan(mask, samples=1024, sampling_interval=8e-9, sound_speed=1480.0, modes=226, highest_frequency=20e6)
    traces = np.random.default_rng(1).standard_normal((mask.count, 1024), dtype=np.float32)
    found = plan.run(traces).values  # type: ignore[union-attr]
    expected = run_inverse(ReferenceEngine(plan.tables), plan.decimate(traces))
    assert np.linalg.norm(found - expected) <= 1e-4 * np.linalg.norm(expected)


def test_it_takes_its_share_of_samples_slices_and_memory() -> None:
    mask = equi_steradian_mask(13.56e-3, 3.6e-3, 400)
    options: dict[str, Any] = {"samples": 1024, "sampling_interval": 8e-9, "sound_speed": 1500.0, "modes": 96}
    whole, part = (flat_plan(mask, highest_frequency=f, **options) for f in (None, 20e6))
    assert part.tables.time.samples < 0.43 * 1024
    assert part.output_bytes < 0.37 * whole.output_bytes
    assert part.memory_bytes < 0.85 * whole.memory_bytes
    traces = np.random.default_rng(4).standard_normal((mask.count, 1024), dtype=np.float32)
    part.run(traces)
    tracemalloc.start()
    part.run(traces)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak <= part.memory_bytes


def test_the_signals_end_is_found() -> None:
    """A-lines of 12 MHz in noise: the image is that of the limit found, and nothing of the signal is lost."""
    rng = np.random.default_rng(5)
    positions = (rng.random((60, 2)) - 0.5) * SIDE
    spectrum = np.fft.rfft(rng.standard_normal((60, 512)))
    spectrum[:, np.fft.rfftfreq(512, INTERVAL) > 12e6] = 0
    traces = np.fft.irfft(spectrum, 512) * np.hanning(512) + 0.002 * rng.standard_normal((60, 512))
    found = flat_reconstruct(traces, positions, modes=24, highest_frequency="signal", **COMMON)
    known = _image(positions, traces, modes=24, highest_frequency=12.5e6)
    whole = _image(positions, traces, modes=24)
    assert known.values.shape[-1] <= found.values.shape[-1] < 0.3 * 512
    energy = [np.linalg.norm(v.values) * np.sqrt(v.spacing[-1]) for v in (found, whole)]
    assert energy[0] == pytest.approx(energy[1], rel=1e-3)


@pytest.mark.parametrize("samples", [64, 65])
def test_share_of_power_above_a_frequency_counts_negative_frequencies(samples: int) -> None:
    times = np.arange(samples) / samples
    traces = (1.0 + np.cos(2 * np.pi * 20 * times))[None]  # power 1 at 0, 1/2 at 20 cycles a record
    assert power_fraction_above(10 / samples, traces, 1.0) == pytest.approx(1 / 3)
    assert power_fraction_above(25 / samples, traces, 1.0) == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("highest_frequency", 0.0),
        ("highest_frequency", -1e6),
        ("highest_frequency", float("nan")),
        ("highest_frequency", 1e5),  # less than two cycles a record
        ("highest_frequency", "signal"),  # a plan has no A-lines to look at
        ("depth_step", 0.0),
        ("depth_step", 1.1e-5),  # finer than samples
        ("depth_step", 1.0),
    ],
)
def test_limits_that_are_none_are_refused(field: str, value: Any) -> None:
    with pytest.raises(InvalidInput, match=field.replace("highest", "max")):
        flat_plan(np.zeros((1, 2)), samples=128, modes=8, **COMMON, **{field: value})


def test_another_word_the_method_iterative_and_samples_that_are_no_numbers_are_refused() -> None:
    traces = np.zeros((2, 128))
    at: dict[str, Any] = {"positions": np.array([[0.0, 0.0], [1e-3, 0.0]]), "modes": 8, **COMMON}
    with pytest.raises(InvalidInput, match=r'max_frequency is loud; allowed: .*"signal"'):
        flat_reconstruct(traces, highest_frequency="loud", **at)  # type: ignore[arg-type]
    with pytest.raises(InvalidInput, match="depth_step"):
        flat_reconstruct(traces, method="iterative", iterative=Iterative(), depth_step=2e-5, **at)
    for none in (traces[:0], traces[:, :0]):
        with pytest.raises(InvalidInput, match="traces"):
            flat_reconstruct(none, highest_frequency="signal", **at)
    traces[1, 17] = np.nan
    with pytest.raises(InvalidInput, match="nan at row 1, column 17"):
        flat_reconstruct(traces, highest_frequency=20e6, **at)


def test_decimated_transform_meets_accuracy() -> None:
    rng = np.random.default_rng(6)
    for samples, band, accuracy in ((1024, 0.16, 1e-5), (1021, 0.3, 1e-5), (64, 0.1, 1e-6), (512, 0.1, 1e-10)):
        fewer = plan_decimation(samples, band, accuracy)
        assert fewer is not None
        traces, f = rng.standard_normal((3, samples)), np.linspace(-band, band, 301)
        expected = traces @ np.exp(-2j * np.pi * np.arange(samples)[:, None] * f)
        times = fewer.first + fewer.every * np.arange(fewer.samples)
        found = fewer.apply(traces, "float64") @ np.exp(-2j * np.pi * times[:, None] * f)
        assert np.linalg.norm(found - expected) <= accuracy * np.linalg.norm(expected)
