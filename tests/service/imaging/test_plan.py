"""Plans: many runs, integers, cancellation, memory, and clear refusals."""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pytest

from steradian.core.exceptions import Cancelled, InvalidInput
from steradian.core.system_resources import cpu_count
from steradian.imaging import Compute, ReconstructionPlan, Volume, VoxelAxes, voronoi_weights
from steradian.imaging.geometry.polygons import contains
from steradian.imaging.geometry.sensor_areas import detect_sensor_grid, sensed_region
from support.flat import flat_plan, flat_reconstruct

RNG = np.random.default_rng(0)
POSITIONS = (RNG.random((40, 2)) - 0.5) * 0.01
TRACES = RNG.standard_normal((40, 64)).astype(np.float32)
COMMON: dict[str, Any] = {"sampling_interval": 8e-9, "sound_speed": 1500.0, "aperture": 0.01, "modes": 16}


def test_a_plan_runs_many_times_and_batches_are_the_single_runs() -> None:
    plan = flat_plan(POSITIONS, samples=64, **COMMON)
    single = plan.run(TRACES)
    batch = plan.run(np.stack([TRACES, 2 * TRACES]))
    assert isinstance(single, Volume)
    assert isinstance(batch, list)
    np.testing.assert_array_equal(batch[0].values, single.values)
    np.testing.assert_allclose(batch[1].values, 2 * single.values, rtol=1e-5, atol=1e-7)
    assert single.values.dtype == np.float32
    assert single.values.flags.c_contiguous


@pytest.mark.parametrize(
    ("said", "found"), [("1", 1), ("1,4", 1), ("", cpu_count()), ("many", cpu_count()), ("9999", cpu_count())]
)
def test_max_threads_respects_omp_num_threads(monkeypatch, said, found) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", said)
    assert Compute().max_threads == found


def test_the_number_of_threads_does_not_change_a_bit() -> None:
    one = flat_plan(POSITIONS, samples=64, threads=1, **COMMON).run(TRACES)
    two = flat_plan(POSITIONS, samples=64, threads=2, **COMMON).run(TRACES)
    np.testing.assert_array_equal(one.values, two.values)


@pytest.mark.parametrize("dtype", [np.int16, np.uint8, np.float64])
def test_integer_traces_with_a_scale_give_the_image_of_their_pressures(dtype: type) -> None:
    counts = np.round(TRACES * 20 + 128).astype(dtype)
    scaled = flat_reconstruct(counts, POSITIONS, scale=0.25, **COMMON).values
    exact = flat_reconstruct((counts * 0.25).astype(np.float32), POSITIONS, **COMMON).values
    np.testing.assert_allclose(scaled, exact, atol=1e-6 * np.abs(exact).max())


def test_strided_traces_are_read_in_the_right_order() -> None:
    wide = np.zeros((64, 80), np.float32)
    wide[:, ::2] = TRACES.T
    np.testing.assert_array_equal(
        flat_reconstruct(wide.T[::2], POSITIONS, **COMMON).values, flat_reconstruct(TRACES, POSITIONS, **COMMON).values
    )


@pytest.mark.long
def test_cancellation_is_polled_and_progress_counted_per_piece(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Once 50 ms have passed, the next question comes after at most one piece; counted, since clocks tell of others."""
    monkeypatch.setattr("steradian.imaging.compute.thread_pool._POLL", 0.0)
    positions = (RNG.random((3000, 2)) - 0.5) * 0.01
    plan = flat_plan(positions, samples=512, **{**COMMON, "modes": 300, "threads": 1})
    traces = np.ones((3000, 512), np.float32)
    asked: list[tuple[str, int, int]] = []
    seen: list[tuple[str, int, int]] = []

    def cancelled() -> bool:
        asked.append(seen[-1])
        return False

    plan.run(traces, progress=lambda *told: seen.append(told), cancelled=cancelled)
    assert asked == seen
    stages = {stage: pieces for stage, _, pieces in asked}
    assert list(stages) == ["lateral transform", "time to depth", "image"]
    for stage, pieces in stages.items():
        assert pieces >= 8
        assert [done for which, done, _ in asked if which == stage] == [*range(pieces + 1), pieces]
    with pytest.raises(Cancelled):
        plan.run(traces, cancelled=lambda: True)


@pytest.mark.parametrize("upsampling", [1, 2])
def test_memory_estimate_matches_peak_and_lower_limit_is_refused(upsampling: int) -> None:
    positions = (RNG.random((500, 2)) - 0.5) * 0.01
    traces = np.ones((500, 256), np.float32)
    common = {**COMMON, "modes": 96, "threads": 2, "upsampling": upsampling}
    plan = flat_plan(positions, samples=256, **common)
    volume, peak = _peak_of_a_run(plan, traces)
    assert 0.8 * plan.memory_bytes < peak <= plan.memory_bytes + 2**20
    assert peak - volume.values.nbytes < volume.values.nbytes
    with pytest.raises(InvalidInput, match="memory_limit"):
        flat_plan(positions, samples=256, memory_limit=plan.memory_bytes - 1, **common)


def test_memory_estimate_excludes_buffers_freed_before_image() -> None:
    """A grid coarser than the modes, whose spectrum has a place of its own until the modes' depths are found."""
    places = (np.arange(80) + 0.5) / 80 * 0.01 - 0.005
    positions = np.stack(np.meshgrid(places, places, indexing="ij"), axis=-1).reshape(-1, 2)
    common = {**COMMON, "modes": 96, "threads": 1, "depth_range": (0.0, 0.5e-3), "upsampling": 2}
    plan = flat_plan(positions, samples=256, **common)
    _, peak = _peak_of_a_run(plan, np.ones((6400, 256), np.float32))
    assert 0.85 * plan.memory_bytes < peak <= plan.memory_bytes + 2**20


def _peak_of_a_run(plan: ReconstructionPlan, traces: np.ndarray) -> tuple[Volume, int]:
    plan.run(traces)  # compiled and cached
    tracemalloc.start()
    volume = plan.run(traces)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert isinstance(volume, Volume)
    return volume, peak


def test_several_images_count_towards_the_limit_when_they_are_asked_for() -> None:
    for upsampling in (1, 2):
        free = flat_plan(POSITIONS, samples=64, upsampling=upsampling, **COMMON)
        limit = free.memory_bytes + 2 * free.output_bytes
        plan = flat_plan(POSITIONS, samples=64, upsampling=upsampling, memory_limit=limit, **COMMON)
        assert isinstance(plan.run(TRACES), Volume)
        with pytest.raises(InvalidInput, match=rf"memory_limit is {limit};.*4 images"):
            plan.run(np.stack(4 * [TRACES]))


@pytest.mark.parametrize(
    ("field", "change"),
    [
        ("sound_speed", {"sound_speed": 0.0}),
        ("sound_speed", {"sound_speed": np.nan}),
        ("dt", {"sampling_interval": -1e-9}),
        ("aperture", {"aperture": 0.005}),
        ("aperture", {"aperture": (0.01, 0.01, 0.01)}),
        ("modes", {"modes": 1}),
        ("modes", {"modes": 16.5}),
        ("weights", {"weights": np.ones(3)}),
        ("weights", {"weights": "area"}),
        ("depth", {"depth_range": (0.0, 1.0)}),
        ("depth", {"depth_range": (2e-4, 1e-4)}),
        ("tolerance", {"tolerance": 0.0}),
        ("method", {"method": "ner"}),
        ("window", {"window": "gauss"}),
        ("dtype", {"dtype": "float16"}),
        ("upsampling", {"upsampling": 0}),
        ("time_padding", {"time_padding": 0.5}),
        ("t0", {"time_zero": np.inf}),
    ],
)
def test_bad_parameters_are_named(field: str, change: dict[str, Any]) -> None:
    with pytest.raises(InvalidInput) as caught:
        flat_reconstruct(TRACES, POSITIONS, **{**COMMON, **change})
    assert caught.value.field == field


def test_a_sample_that_is_not_finite_is_found_by_row_and_column() -> None:
    traces = TRACES.copy()
    traces[17, 40] = np.nan
    with pytest.raises(InvalidInput, match="row 17, column 40"):
        flat_reconstruct(traces, POSITIONS, **COMMON)
    traces[17, 40] = -np.inf
    with pytest.raises(InvalidInput, match="row 17, column 40"):
        flat_reconstruct(traces, POSITIONS, **COMMON)


@pytest.mark.parametrize("shape", [(39, 64), (40, 64, 1), (64, 40)])
def test_traces_must_have_a_row_for_each_sensor(shape: tuple[int, ...]) -> None:
    with pytest.raises(InvalidInput, match="traces"):
        flat_reconstruct(np.zeros(shape), POSITIONS, **COMMON)


def test_positions_must_be_finite_points_of_a_plane_or_line() -> None:
    bad = POSITIONS.copy()
    bad[5, 1] = np.nan
    for positions in (bad, np.zeros((40, 3)), np.zeros((0, 2))):
        with pytest.raises(InvalidInput, match="sensors"):
            flat_reconstruct(TRACES, positions, **COMMON)


def test_duplicate_sensors_add_up_like_one_with_the_sum_of_their_weights() -> None:
    positions = np.concatenate([POSITIONS, POSITIONS[:3]])
    weights = np.full(43, 1e-4 / 40)
    weights[:3] = weights[40:] = 0.5e-4 / 40
    twice = flat_reconstruct(np.concatenate([TRACES, TRACES[:3]]), positions, weights=weights, **COMMON).values
    once = flat_reconstruct(TRACES, POSITIONS, weights=np.full(40, 1e-4 / 40), **COMMON).values
    np.testing.assert_allclose(twice, once, atol=1e-5 * np.abs(once).max())


def test_voronoi_weights_equal_cell_areas_in_sensed_region() -> None:
    axis = (np.arange(8) - 3.5) / 8
    positions = np.stack(np.meshgrid(axis, axis * 0.5, indexing="ij"), axis=-1).reshape(-1, 2)
    np.testing.assert_allclose(voronoi_weights(positions, (1.0, 0.5)), 1 / 128, rtol=1e-6)
    np.testing.assert_allclose(voronoi_weights(positions / 2, (1.0, 0.5)), 1 / 512, rtol=1e-6)
    scattered = RNG.random((200, 2)) - 0.5
    scattered[:2] = [[0.5, 0.5], [-0.5, 0.1]]
    weights = voronoi_weights(scattered, 1.0)
    assert weights.sum() == pytest.approx(1.0, abs=0.02)  # but for the corners without a sensor
    assert weights.min() > 0
    # a Monte Carlo of the same cells
    points = 1.2 * (RNG.random((40000, 2)) - 0.5)
    points = points[contains(sensed_region(scattered, 1.0), points)]
    owner = ((points[:, None] - scattered[None]) ** 2).sum(-1).argmin(1)
    assert np.abs(np.bincount(owner, minlength=200) * 1.44 / 40000 - weights).max() < 0.002


def test_grid_with_a_displaced_line_is_not_a_grid() -> None:
    axis = (np.arange(8) - 3.5) / 8
    positions = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    assert detect_sensor_grid(positions) is not None
    positions[positions[:, 0] == axis[3], 0] += 0.1 / 8
    assert detect_sensor_grid(positions) is None


def test_cells_of_a_line_end_half_a_mean_spacing_beyond_it_and_sensors_at_one_place_share_theirs() -> None:
    np.testing.assert_allclose(voronoi_weights([-0.4, 0.0, 0.1], 10.0), [0.325, 0.25, 0.175])
    np.testing.assert_allclose(voronoi_weights([-0.4, 0.0, 0.1, 0.1], 1.0), [0.325, 0.25, 0.0875, 0.0875])
    np.testing.assert_allclose(voronoi_weights(np.zeros((5, 2)), (1.0, 0.5)), 0.1)
    with pytest.raises(InvalidInput, match="positions"):
        voronoi_weights(np.zeros((0, 2)), 1.0)


def test_each_mip_removes_its_own_axis() -> None:
    values = np.zeros((3, 4, 5), np.float32)
    values[2, 1, 3] = 7
    axes = VoxelAxes(np.arange(3.0), np.arange(4.0), np.arange(5.0))
    volume = Volume(values, axes, (1.0, 1.0, 1.0))
    assert volume.mip("z").shape == (3, 4)
    assert volume.mip("z")[2, 1] == 7
    assert volume.mip("x")[1, 3] == 7
    assert volume.mip("y")[2, 3] == 7
    flat = Volume(values[:, 0], VoxelAxes(np.arange(3.0), None, np.arange(5.0)), (1.0, 1.0))
    assert flat.mip("z").shape == (3,)
    with pytest.raises(InvalidInput, match="axis"):
        flat.mip("y")


def test_importing_the_package_does_not_import_numba() -> None:
    import subprocess
    import sys

    code = "import sys, steradian.imaging; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
