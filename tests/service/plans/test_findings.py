"""What stands against a plan is told with the field and the range that would do."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steradian import InvalidInput, ScanPlan, equi_steradian_mask, grid_mask
from steradian.plans import Link, Motion, ScannerLimits, Tuning, preview

MASK = equi_steradian_mask(13.56e-3, 3.6e-3, 400)


def only(plan, severity, field, **wanted):
    """Preview a plan that has exactly one finding."""
    (finding,) = preview(plan, **wanted).findings
    assert (finding.severity, finding.field) == (severity, field)
    return finding


def test_a_good_plan_has_no_findings():
    """The default plan of the paper's mask passes."""
    cost = preview(ScanPlan.create(mask=MASK), free_bytes=10**9, resolution=1e-3)
    assert cost.findings == ()
    assert not cost.has_errors


def test_points_out_of_the_field_refuse():
    """The farthest point and the field's range are named."""
    narrow = ScannerLimits(x=(-5e-3, 8e-3))
    finding = only(ScanPlan.create(mask=MASK, scanner=narrow), "error", "mask.positions")
    assert "-5 mm to 8 mm" in finding.allowed


@pytest.mark.parametrize(
    ("limits", "plan", "field", "allowed"),
    [
        ({"pulse_rate": (1, 40)}, {}, "pulse_rate", "1 to 40 Hz"),
        ({"averages": (1, 10)}, {"averages": 11}, "averages", "1 to 10"),
        ({"samples": (16, 512)}, {}, "samples", "16 to 512"),
        ({"sampling_interval": (1e-9, 5e-9)}, {}, "sampling_interval", "1e-09 to 5e-09 s"),
        ({}, {"wavelengths": np.full(MASK.count, 1.4e-6)}, "wavelengths", "1500 to 1600 nm"),
    ],
)
def test_plan_exceeding_scanner_limits_is_refused(limits, plan, field, allowed):
    """Each figure is compared with the scanner's range."""
    wanted = ScanPlan.create(mask=MASK, scanner=ScannerLimits(**limits), **plan)
    assert only(wanted, "error", field).allowed == allowed


def test_a_rate_beyond_the_link_refuses_and_names_the_baud_that_would_do():
    """50 Hz of 2,048 samples is too much for 921,600 baud, and 3 Mbaud carries it."""
    finding = only(ScanPlan.create(mask=MASK, samples=2048, link=Link.serial(921_600)), "error", "pulse_rate")
    assert "3,000,000 baud would do" in finding.message
    assert "at most 18" in finding.allowed
    assert preview(ScanPlan.create(mask=MASK, samples=2048, link=Link.serial(3_000_000))).findings == ()


@settings(max_examples=30, deadline=None)
@given(rate=st.floats(1, 3000), samples=st.integers(64, 4096), baud=st.sampled_from([115_200, 921_600, 3_000_000]))
def test_the_rate_and_the_baud_that_are_allowed_are_allowed(rate, samples, baud):
    """What a finding offers as a remedy is one."""
    plan = ScanPlan.create(mask=MASK, pulse_rate=rate, samples=samples, link=Link.serial(baud))
    link = [finding for finding in preview(plan).findings if finding.field == "pulse_rate"]
    if link:
        faster = float(link[0].message.split("; ")[1].split(" baud")[0].replace(",", ""))
        mended = preview(plan.replace(link=Link.serial(faster)))
        assert not [finding for finding in mended.findings if finding.field == "pulse_rate"]


@pytest.mark.parametrize(
    ("baud", "samples", "lines"), [(115_200, 1024, 4.6), (921_600, 2048, 19), (3_000_000, 4096, 31)]
)
def test_serial_link_rate_matches_measurement(baud, samples, lines):
    """A-lines per second at 90 % load, as measured on real baud rates."""
    assert Link.serial(baud).alines_per_second(samples) == pytest.approx(lines, rel=0.04)


def test_records_that_end_too_early_warn_or_refuse():
    """Too short for the farthest sensor: a warning; for the point of interest itself: an error. Both say how long."""
    farthest = np.hypot(np.linalg.norm(MASK.positions, axis=1).max(), 3.6e-3)
    need = int(np.ceil(farthest / 1500 / 8e-9)) + 1
    finding = only(ScanPlan.create(mask=MASK, samples=need - 1), "warning", "samples")
    assert finding.allowed == f"at least {need}"
    assert preview(ScanPlan.create(mask=MASK, samples=need)).findings == ()
    finding = only(ScanPlan.create(mask=MASK, samples=256), "error", "samples")
    assert finding.allowed == f"at least {int(np.ceil(3.6e-3 / 1500 / 8e-9)) + 1}"


def test_a_spacing_too_wide_for_the_resolution_warns():
    """Half the resolution is asked of the densest part, and about how many points that takes."""
    finding = only(ScanPlan.create(mask=MASK), "warning", "mask", resolution=200e-6)
    assert "at most 100 µm" in finding.allowed
    grid = grid_mask(1e-2, 100, 1e-4)
    assert preview(ScanPlan.create(mask=grid), resolution=201e-6).findings == ()
    assert only(ScanPlan.create(mask=grid), "warning", "mask", resolution=199e-6)


def test_a_disk_too_small_refuses_and_a_tight_one_warns():
    """The hard need refuses, a margin of a fifth warns."""
    plan = ScanPlan.create(mask=MASK)
    need = preview(plan).bytes + 40 * MASK.count
    assert only(plan, "error", "disk", free_bytes=need - 1)
    assert only(plan, "warning", "disk", free_bytes=need + 1)
    assert preview(plan, free_bytes=2 * need).findings == ()


@pytest.mark.parametrize(
    ("build", "field"),
    [
        (lambda: Motion.create(speed=0), "speed"),
        (lambda: Motion.create(settling=-1), "settling"),
        (lambda: Tuning.create(tolerance=-1), "tolerance"),
        (lambda: Link.create(byte_rate=0), "byte_rate"),
        (lambda: Link.create(load=2), "load"),
        (lambda: Link.serial(0), "baud"),
        (lambda: ScannerLimits.create(x=(1, 0)), "x"),
    ],
)
def test_models_of_the_scanner_name_their_ranges(build, field):
    """A figure out of range is refused with its name and what is allowed."""
    with pytest.raises(InvalidInput) as refused:
        build()
    assert refused.value.field == field
    assert refused.value.allowed
