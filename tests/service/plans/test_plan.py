"""Plans visit every point once and tell their cost."""

import numpy as np
import pytest

from steradian import InvalidInput, ScanPlan, equi_steradian_mask
from steradian.plans import VisitOrder, preview, travel


@pytest.fixture(scope="module")
def mask():
    return equi_steradian_mask(13.56e-3, 3.6e-3, 1600)


@pytest.mark.parametrize("order", list(VisitOrder))
def test_every_point_is_visited_once(mask, order):
    """A visit order is a permutation of the points."""
    plan = ScanPlan.create(mask=mask, order=order)
    assert sorted(plan.visit) == list(range(mask.count))


def test_snake_travels_less_than_the_rings(mask):
    """Visiting in strips is shorter than slice by slice."""
    rings, snake = (
        travel(mask.positions, ScanPlan.create(mask=mask, order=order).visit) for order in ("given", "snake")
    )
    assert snake < rings


def test_preview_counts_pulses_and_bytes(mask):
    """Time is points × averages / rate; bytes are what the A-lines take."""
    cost = preview(ScanPlan.create(mask=mask, pulse_rate=50, averages=2, samples=512))
    assert cost.laser_seconds == pytest.approx(1605 * 2 / 50)
    assert cost.bytes == 1605 * 512 * 2


def test_preview_warns_of_records_too_short(mask):
    """The farthest sensor, 7.7 mm from the point of interest, needs 641 samples of 12 µm."""
    finding = preview(ScanPlan.create(mask=mask, samples=256)).findings[0]
    farthest = np.hypot(np.linalg.norm(mask.positions, axis=1).max(), 3.6e-3)
    assert str(int(np.ceil(farthest / 1500 / 8e-9)) + 1) in finding.message
    assert finding.field == "samples"
    assert not preview(ScanPlan.create(mask=mask, samples=1024)).findings


@pytest.mark.parametrize(
    ("field", "value"), [("pulse_rate", 0), ("samples", 3), ("averages", 0), ("sound_speed", -1), ("order", "zigzag")]
)
def test_bad_values_are_named(mask, field, value):
    """A wrong value is refused with its field's name."""
    with pytest.raises(InvalidInput) as refused:
        ScanPlan.create(mask=mask, **{field: value})
    assert refused.value.field == field


def test_pulses_may_not_overlap_records(mask):
    """A record longer than the pulse period is refused with the largest rate."""
    with pytest.raises(InvalidInput, match="pulse_rate"):
        ScanPlan.create(mask=mask, pulse_rate=9000, samples=65536, sampling_interval=1e-8)
