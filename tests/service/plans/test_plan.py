"""Plans are checked, immutable values that tell their cost."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steradian import InvalidInput, ScanPlan, equi_steradian_mask, grid_mask
from steradian.plans import Link, Motion, Tuning, VisitOrder, path_length, preview
from steradian.plans.plots import draw_plan


@pytest.fixture(scope="module")
def mask():
    return equi_steradian_mask(13.56e-3, 3.6e-3, 1600)


def test_snake_travels_less_than_the_rings(mask):
    """Visiting in strips is shorter than slice by slice."""
    rings, snake = (
        path_length(mask.positions, ScanPlan.create(mask=mask, order=order).visit) for order in ("given", "snake")
    )
    assert snake < rings


def test_preview_counts_pulses_and_bytes(mask):
    """Laser time is points × averages / rate; bytes are what the A-lines take."""
    cost = preview(ScanPlan.create(mask=mask, pulse_rate=50, averages=2, samples=512))
    assert cost.laser_seconds == cost.seconds["laser"] == pytest.approx(1605 * 2 / 50)
    assert cost.total_seconds == pytest.approx(1605 * 2 / 50)
    assert cost.limiting == "laser"
    assert cost.bytes == 1605 * 512 * 2


def test_a_move_longer_than_the_pulse_period_costs_a_second_period():
    """At 1 mm between points and 1 m/s with 0.4 ms settling, 1.4 ms a move: two periods of 1 kHz each."""
    plan = ScanPlan.create(
        mask=grid_mask(1e-2, 10, 1e-3),
        pulse_rate=1000,
        motion=Motion(speed=1.0),
        link=Link(byte_rate=None),
    )
    cost = preview(plan)
    assert cost.limiting == "mover"
    assert cost.seconds["mover"] == pytest.approx(cost.travel / 1.0 + 99 * 0.4e-3)
    assert cost.total_seconds == pytest.approx(99 * 2e-3 + 1e-3)


def test_preview_with_slow_disk_is_limited_by_disk(mask):
    """A slow disk decides, and is named."""
    plan = ScanPlan.create(mask=mask, pulse_rate=400)
    cost = preview(plan, disk_rate=1e5)
    assert cost.limiting == "disk"
    assert cost.total_seconds == cost.seconds["disk"] == pytest.approx((cost.bytes + 1605 * 40) / 1e5)


@settings(max_examples=30, deadline=None)
@given(
    rate=st.floats(1, 5000),
    averages=st.integers(1, 20),
    settling=st.floats(0, 0.01),
    tuned=st.booleans(),
    order=st.sampled_from(["given", "snake", "hilbert"]),
)
def test_no_part_of_the_time_is_forgotten(rate, averages, settling, tuned, order):
    """The whole is at least its longest part, at most the sum of all and a period a point; the limiting is one."""
    grid = grid_mask(1e-2, 9, 1e-3)
    wavelengths = 1.55e-6 + np.arange(81) % 3 * 1e-10 if tuned else None
    plan = ScanPlan.create(
        mask=grid,
        pulse_rate=rate,
        averages=averages,
        motion=Motion(settling=settling),
        wavelengths=wavelengths,
        order=order,
    )
    cost = preview(plan)
    parts = cost.seconds.values()
    assert max(parts) <= cost.total_seconds * (1 + 1e-9)
    assert cost.total_seconds <= sum(parts) + grid.count / rate
    assert cost.limiting in cost.seconds
    assert (cost.retunings > 0) == tuned


@pytest.mark.parametrize("tuned", [True, False])
def test_a_plan_survives_json(mask, tuned):
    """A plan written as JSON is read back as the same plan, with all its models."""
    wavelengths = np.linspace(1.55e-6, 1.56e-6, mask.count) if tuned else None
    plan = ScanPlan.create(
        mask=mask, wavelengths=wavelengths, tuning=Tuning(speed=1e-6), link=Link.serial(3_000_000), order="hilbert"
    )
    again = ScanPlan.model_validate_json(plan.model_dump_json())
    assert again.id == plan.id
    assert again.link == plan.link
    apart = ScanPlan.create(mask=mask, **plan.model_dump(mode="json", exclude={"mask"}))
    assert apart.id == plan.id


def test_everything_that_changes_a_scan_changes_its_identifier(mask):
    """Other link, motion or order: another plan."""
    plans = [
        ScanPlan.create(mask=mask),
        ScanPlan.create(mask=mask, order="hilbert"),
        ScanPlan.create(mask=mask, motion=Motion(speed=1.0)),
        ScanPlan.create(mask=mask, link=Link.serial(921_600)),
    ]
    assert len({plan.id for plan in plans}) == len(plans)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("pulse_rate", 0),
        ("pulse_rate", float("nan")),
        ("samples", 3),
        ("averages", 0),
        ("sound_speed", -1),
        ("sampling_interval", 1),
        ("order", "zigzag"),
    ],
)
def test_bad_values_are_named(mask, field, value):
    """A wrong value is refused with its field's name and range."""
    with pytest.raises(InvalidInput) as refused:
        ScanPlan.create(mask=mask, **{field: value})
    assert refused.value.field == field
    assert refused.value.allowed


def test_pulses_may_not_overlap_records(mask):
    """A record longer than the pulse period is refused with the largest rate."""
    with pytest.raises(InvalidInput, match="pulse_rate"):
        ScanPlan.create(mask=mask, pulse_rate=9000, samples=65536, sampling_interval=1e-8)


@pytest.mark.long
@pytest.mark.parametrize("order", [VisitOrder.SNAKE, VisitOrder.PROGRESSIVE])
def test_a_plan_can_be_drawn(mask, order, tmp_path):
    """A PNG is written whole."""
    draw_plan(ScanPlan.create(mask=mask, order=order), tmp_path / "plan.png")
    assert (tmp_path / "plan.png").read_bytes()[:4] == b"\x89PNG"
