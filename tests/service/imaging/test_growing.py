"""An image that grows with its A-lines is the image of the A-lines so far."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from steradian.core.exceptions import Cancelled, InvalidInput
from steradian.imaging import ReconstructionPlan, Volume
from steradian.imaging.incremental import IncrementalReconstruction
from support.flat import flat_plan

SIDE = 0.01
AXIS = (np.arange(16) - 8) * SIDE / 16
COARSE = AXIS[::2]
COMMON: dict[str, Any] = {"samples": 70, "sampling_interval": 8e-9, "sound_speed": 1500.0, "aperture": SIDE}


def _positions(kind: str) -> np.ndarray:
    random = np.random.default_rng(3)
    match kind:
        case "anywhere":
            return (random.random((90, 2)) - 0.5) * SIDE
        case "grid":
            return np.stack(np.meshgrid(AXIS, AXIS, indexing="ij"), axis=-1).reshape(-1, 2)
        case "coarse grid":
            return np.stack(np.meshgrid(COARSE, COARSE, indexing="ij"), axis=-1).reshape(-1, 2)
        case "line":
            return AXIS
        case _:
            return (random.random(40) - 0.5) * SIDE


def _distance(image: Volume, reference: Volume) -> float:
    return float(np.linalg.norm(image.values - reference.values) / np.linalg.norm(reference.values))


def _reference(
    plan: ReconstructionPlan, chosen: np.ndarray, weights: np.ndarray, traces: np.ndarray, **more: Any
) -> Volume:
    found = flat_plan(plan.geometry.positions[chosen], weights=weights[chosen], **more).run(traces[chosen])
    assert isinstance(found, Volume)
    return found


@pytest.mark.parametrize("fitted", [True, False])
@pytest.mark.parametrize("kind", ["anywhere", "grid", "coarse grid", "line", "line, anywhere"])
def test_after_each_batch_it_is_the_image_of_a_plan_made_for_the_sensors_so_far(kind: str, fitted: bool) -> None:
    positions = _positions(kind)
    count = len(positions)
    random = np.random.default_rng(5)
    traces, weights = random.standard_normal((count, 70)).astype(np.float32), 0.1 + random.random(count)
    weights *= SIDE ** (1 if "line" in kind else 2) / weights.sum()
    options = COMMON | {"modes": 32 if "line" in kind else 16}
    plan = flat_plan(positions, weights=weights, **options)
    growing = IncrementalReconstruction(plan, fitted=fitted)
    for batch in np.array_split(random.permutation(count), 5):
        growing.add(batch, traces[batch])
        now = growing.measured
        assert _distance(growing.volume(), _reference(plan, now, growing.weights, traces, **options)) < 5e-5
        assert growing.weights.sum() == pytest.approx(weights.sum())
        assert (growing.weights[~now] == 0).all()
    np.testing.assert_allclose(growing.weights, weights, rtol=1e-12)
    assert _distance(growing.volume(), plan.run(traces)) < 2e-5  # type: ignore[arg-type]


def test_a_thousand_single_alines_lose_no_accuracy() -> None:
    random = np.random.default_rng(6)
    positions = (random.random((1000, 2)) - 0.5) * SIDE
    traces = random.standard_normal((1000, 70)).astype(np.float32)
    plan = flat_plan(positions, modes=16, **COMMON)
    growing = IncrementalReconstruction(plan)
    for sensor in range(1000):
        growing.add([sensor], traces[sensor : sensor + 1])
    assert _distance(growing.volume(), plan.run(traces)) < 1e-4  # type: ignore[arg-type]


def test_where_half_the_points_of_one_side_are_missing_the_others_there_stand_for_them() -> None:
    positions = _positions("grid")
    plan = flat_plan(positions, modes=16, **COMMON)
    growing = IncrementalReconstruction(plan)
    left = positions[:, 0] < 0
    thinned = left & (np.arange(256) % 2 == 0)
    chosen = np.flatnonzero(thinned | ~left)
    growing.add(chosen, np.ones((len(chosen), 70), np.float32))
    sides = [growing.weights[thinned].sum(), growing.weights[~left].sum()]
    assert sides[0] / sides[1] == pytest.approx(1.0, abs=0.07)  # a column at the border is shared by both
    unfitted = IncrementalReconstruction(plan, fitted=False)
    unfitted.add(chosen, np.ones((len(chosen), 70), np.float32))
    assert unfitted.weights[thinned].sum() / unfitted.weights[~left].sum() == pytest.approx(0.5)


def test_partial_strip_weights_stay_bounded_at_edge() -> None:
    positions = _positions("grid")
    growing = IncrementalReconstruction(flat_plan(positions, modes=16, **COMMON))
    strip = np.flatnonzero(positions[:, 0] < AXIS[3])
    growing.add(strip, np.ones((len(strip), 70), np.float32))
    weights = growing.weights[strip]
    assert weights.max() / weights.min() < 3
    assert growing.covered_fraction == pytest.approx(len(strip) / 256)


def test_clear_forgets_everything() -> None:
    positions = _positions("anywhere")
    traces = np.random.default_rng(7).standard_normal((90, 70)).astype(np.float32)
    plan = flat_plan(positions, modes=16, **COMMON)
    growing = IncrementalReconstruction(plan)
    growing.add(np.arange(40), traces[:40] + 1)
    growing.clear()
    assert growing.covered_fraction == 0
    growing.add(np.arange(90), traces)
    assert _distance(growing.volume(), plan.run(traces)) < 2e-5  # type: ignore[arg-type]


def test_integers_and_a_limited_depth_are_taken_like_by_a_plan() -> None:
    positions = _positions("coarse grid")
    counts = np.random.default_rng(8).integers(-100, 100, (64, 70)).astype(np.int16)
    plan = flat_plan(positions, modes=16, depth_range=(1e-4, 5e-4), upsampling=2, **COMMON)
    growing = IncrementalReconstruction(plan)
    growing.add(np.arange(64), counts)
    assert _distance(growing.volume(), plan.run(counts)) < 2e-5  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("sensors", "rows", "field"),
    [([0, 0], 2, "sensors"), ([5], 1, "sensors"), ([90], 1, "sensors"), ([-1], 1, "sensors"), ([1, 2], 1, "traces")],
)
def test_invalid_add_is_refused_and_keeps_volume(sensors: list[int], rows: int, field: str) -> None:
    growing = IncrementalReconstruction(flat_plan(_positions("anywhere"), modes=16, **COMMON))
    growing.add([5], np.ones((1, 70)))
    before = growing.volume().values
    with pytest.raises(InvalidInput) as refused:
        growing.add(sensors, np.ones((rows, 70)))
    assert refused.value.field == field
    bad = np.ones((1, 70))
    bad[0, 3] = np.nan
    with pytest.raises(InvalidInput, match="finite"):
        growing.add([6], bad)
    np.testing.assert_array_equal(growing.volume().values, before)


def test_there_is_no_image_of_nothing_and_none_of_a_method_that_is_no_sum() -> None:
    growing = IncrementalReconstruction(flat_plan(_positions("anywhere"), modes=16, **COMMON))
    with pytest.raises(InvalidInput, match="at least one A-line"):
        growing.volume()
    with pytest.raises(InvalidInput, match="grows"):
        IncrementalReconstruction(flat_plan(_positions("anywhere"), modes=16, method="interpolated", **COMMON))


def test_it_can_be_cancelled() -> None:
    growing = IncrementalReconstruction(flat_plan(_positions("anywhere"), modes=16, **COMMON))
    with pytest.raises(Cancelled):
        growing.add([0], np.ones((1, 70)), cancelled=lambda: True)
