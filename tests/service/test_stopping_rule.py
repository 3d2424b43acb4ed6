"""Stopping rule of scans: images that are means of random terms, whose errors have closed forms."""

import numpy as np
import pytest

from steradian.core.exceptions import InvalidInput
from steradian.quality import correlation
from steradian.quality.stopping_rule import (
    RevisionImage,
    StoppingRule,
    decide,
    expected_change,
    expected_gain,
    expected_noise_db,
)

PLANNED = 1600
OBJECT = np.outer(np.hanning(80), np.hanning(80))
SIGMA = 2.0


def revisions_until(share, planned=PLANNED, sigma=SIGMA, seed=0):
    """Return images that are means of n noisy terms, at each sixteenth of the points."""
    random, total, done, found = np.random.default_rng(seed), np.zeros_like(OBJECT), 0, []
    for part in range(4, round(16 * share) + 1):
        points = part * planned // 16
        total = total + random.normal(0, sigma * np.sqrt(points - done), OBJECT.shape)
        done = points
        found.append(RevisionImage(points, OBJECT + total / points))
    return found


@pytest.mark.parametrize("share", [0.5, 0.75, 0.875])
def test_expected_change_is_that_of_the_image_of_all_points(share):
    parts, whole = revisions_until(share), revisions_until(1.0)
    np.testing.assert_array_equal(parts[-1].image, whole[len(parts) - 1].image)
    actual = 1 - correlation(parts[-1].image, whole[-1].image)
    assert expected_change(parts, PLANNED) == pytest.approx(actual, rel=0.2)


def test_expected_noise_is_the_error_of_the_mean():
    parts = revisions_until(0.75)
    error = SIGMA / np.sqrt(parts[-1].points)
    expected = 20 * np.log10(error / np.abs(parts[-1].image).max())
    assert expected_noise_db(parts) == pytest.approx(expected, abs=0.5)


def test_expected_gain_falls_to_nothing_at_the_last_point():
    gains = [expected_gain(revisions_until(share), PLANNED) for share in (0.5, 0.75, 1.0)]
    assert gains[0] > gains[1] > gains[2] == 0


@pytest.mark.parametrize(
    ("rule", "reason"),
    [
        (StoppingRule(max_gain=0.9), "gain"),
        (StoppingRule(max_gain=None, max_change=0.9), "change"),
        (StoppingRule(max_gain=None, max_noise_db=-1.0), "noise"),
        (StoppingRule(max_gain=None, max_points=1000), "points"),
    ],
)
def test_each_limit_ends_the_scan_and_is_named(rule, reason):
    decision = decide(rule, revisions_until(0.75), PLANNED)
    assert (decision.stop, decision.reason) == (True, reason)
    assert decision.earliest == decision.latest == min(1200, rule.max_points or 1200)


def test_no_limit_ends_a_scan_before_the_least_number_of_points():
    rule = StoppingRule(max_gain=0.9, max_change=0.9, max_noise_db=-1.0)
    assert not decide(rule, revisions_until(0.4375), PLANNED).stop
    assert decide(rule, revisions_until(0.5), PLANNED).stop
    late = StoppingRule(max_gain=0.9, min_points=1500)
    assert not decide(late, revisions_until(0.875), PLANNED).stop
    assert decide(late, revisions_until(0.875), PLANNED).earliest == 1500


def test_noisy_image_goes_on_and_the_end_is_a_range_that_holds():
    limit = 0.01
    rule = StoppingRule(max_gain=None, max_change=limit)
    early = decide(rule, revisions_until(0.5), PLANNED)
    assert not early.stop
    assert early.earliest <= early.latest <= PLANNED
    ended = next(
        parts[-1].points for parts in map(revisions_until, np.arange(9, 17) / 16) if decide(rule, parts, PLANNED).stop
    )
    assert 0.9 * early.earliest <= ended <= 1.1 * early.latest + PLANNED / 16


def test_identical_images_end_the_scan_at_its_least():
    parts = [RevisionImage(points, OBJECT) for points in (400, 600, 800)]
    decision = decide(StoppingRule(), parts, PLANNED)
    assert decision.stop
    assert decision.change == pytest.approx(0, abs=1e-12)


def test_rule_without_images_knows_the_limits_only():
    decision = decide(StoppingRule(), [], PLANNED)
    assert (decision.stop, decision.change, decision.earliest, decision.latest) == (False, None, 800, PLANNED)
    assert decide(StoppingRule(), revisions_until(0.25), PLANNED).gain is None


def test_constant_images_say_nothing():
    parts = [RevisionImage(points, np.zeros((4, 4))) for points in (400, 1200)]
    assert not decide(StoppingRule(), parts, PLANNED).stop


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"max_gain": 0.0}, "max_gain"),
        ({"max_change": 1.0}, "max_change"),
        ({"max_noise_db": 0.0}, "max_noise_db"),
        ({"min_points": -1}, "min_points"),
        ({"min_points": 100, "max_points": 50}, "max_points"),
    ],
)
def test_rule_refuses_and_names_the_field(options, field):
    with pytest.raises(InvalidInput) as error:
        StoppingRule(**options)
    assert error.value.field == field


@pytest.mark.parametrize(
    ("parts", "planned", "field"),
    [
        ([RevisionImage(200, OBJECT), RevisionImage(100, OBJECT)], PLANNED, "revisions"),
        ([RevisionImage(200, OBJECT)], 100, "planned"),
        ([RevisionImage(100, OBJECT[:5]), RevisionImage(200, OBJECT)], PLANNED, "revisions[0]"),
    ],
)
def test_decision_refuses_and_names_the_field(parts, planned, field):
    with pytest.raises(InvalidInput) as error:
        decide(StoppingRule(), parts, planned)
    assert error.value.field == field
