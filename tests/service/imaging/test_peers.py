"""Second opinions: FINUFFT for the lateral step, plain interpolation for κ, the methods against one another."""

from __future__ import annotations

import numpy as np

from steradian.imaging import spectrum_of
from support.flat import flat_plan, flat_reconstruct

GEOMETRY = {"sampling_interval": 8e-9, "sound_speed": 1500.0, "aperture": 0.01}


def test_a_depth_independent_row_of_the_spectrum_is_finuffts() -> None:
    """At j ≈ 0 and short records κ ≈ l, so F is twice FINUFFT's lateral sum of the traces' plain transform."""
    import finufft

    rng = np.random.default_rng(0)
    positions = rng.random((400, 2)) - 0.5
    traces = rng.standard_normal((400, 64))
    modes = 20
    # a record so short beside the aperture that κ(j, l) = l to 1e-9 for every j
    same = {"weights": np.full(400, 1 / 400), "aperture": 1.0, "modes": modes}
    volume = flat_reconstruct(traces, positions, sampling_interval=1e-10, sound_speed=300.0, **same)
    lines = np.fft.rfft(traces, axis=1)
    l = 11  # noqa: E741
    angles = 2 * np.pi * positions
    expected = finufft.nufft2d1(
        angles[:, 0].copy(), angles[:, 1].copy(), lines[:, l] * (modes**2 / 400), (modes, modes), eps=1e-9, isign=-1
    )
    j = np.stack(np.meshgrid(*[np.arange(-modes // 2, modes // 2)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    found = spectrum_of(volume.values, j, np.full(len(j), l)).reshape(modes, modes)
    assert np.linalg.norm(found - 2 * expected) < 1e-4 * np.linalg.norm(2 * expected)


def test_linear_interpolation_approaches_the_exact_kappa_with_finer_padding() -> None:
    rng = np.random.default_rng(1)
    axis = (np.arange(16) - 8) * 0.01 / 16
    positions = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    traces = rng.standard_normal((256, 64)) * np.exp(-(((np.arange(64) - 30) / 12) ** 2))
    errors = []
    for padding in (1, 4, 16):
        common = {**GEOMETRY, "modes": 16, "time_padding": padding}
        exact = flat_reconstruct(traces, positions, **common).values
        linear = flat_reconstruct(traces, positions, method="linear", **common).values
        errors.append(np.linalg.norm(linear - exact) / np.linalg.norm(exact))
    assert errors[0] > 0.02
    assert errors[2] < 2e-3
    assert errors[0] > 4 * errors[1] > 16 * errors[2]


def test_nearest_is_worse_than_linear_and_linear_than_exact() -> None:
    rng = np.random.default_rng(1)
    positions = (np.arange(32) - 16) * 0.01 / 32
    traces = rng.standard_normal((32, 64)) * np.exp(-(((np.arange(64) - 30) / 12) ** 2))
    images = {
        m: flat_reconstruct(traces, positions, method=m, modes=32, **GEOMETRY).values
        for m in ("ner", "linear", "nearest")
    }
    off = {m: np.linalg.norm(images[m] - images["ner"]) for m in ("linear", "nearest")}
    assert 0 < off["linear"] < off["nearest"]


def test_filling_a_complete_grid_changes_nothing_and_a_smooth_gap_is_filled() -> None:
    axis = (np.arange(24) - 12) * 0.01 / 24
    positions = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    t = np.arange(64)
    traces = np.exp(-(((t - 30 - 400 * positions[:, :1]) / 6) ** 2)) * np.exp(
        -((positions**2).sum(1)[:, None] / 0.003**2)
    )
    exact = flat_reconstruct(traces, positions, modes=24, **GEOMETRY).values
    same = flat_reconstruct(traces, positions, modes=24, method="interpolated", **GEOMETRY).values
    np.testing.assert_allclose(same, exact, atol=1e-6 * np.abs(exact).max())
    kept = np.random.default_rng(2).random(len(positions)) < 0.8
    filled = flat_reconstruct(traces[kept], positions[kept], modes=24, method="interpolated", **GEOMETRY).values
    zeroed = flat_reconstruct(traces[kept], positions[kept], modes=24, **GEOMETRY).values
    assert np.linalg.norm(filled - exact) < 0.5 * np.linalg.norm(zeroed - exact)


def test_gridded_and_scattered_paths_agree() -> None:
    """The same sensors on a grid, once with one more sensor of weight 0 off the grid."""
    axis = (np.arange(16) - 8) * 0.01 / 16
    positions = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    traces = np.random.default_rng(3).standard_normal((257, 64))
    weights = np.full(257, 1e-4 / 256)
    weights[-1] = 0
    plan = flat_plan(positions, samples=64, modes=16, **GEOMETRY)
    other = flat_plan(
        np.concatenate([positions, [[0.00123, 0.00321]]]), samples=64, modes=16, weights=weights, **GEOMETRY
    )
    assert (plan.method, other.method) == ("ner", "nedner")
    a, b = plan.run(traces[:256]).values, other.run(traces).values
    assert np.linalg.norm(a - b) < 1e-4 * np.linalg.norm(a)
