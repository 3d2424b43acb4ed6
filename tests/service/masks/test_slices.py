"""A cap is sliced by the paper's rule, and convenient counts are really the nearest."""

from math import cos, pi

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steradian.masks.cap_slices import convenient_below, convenient_slices, slice_cap


@settings(max_examples=30, deadline=None)
@given(rim=st.floats(0.1, 1.5), count=st.integers(6, 600))
def test_no_convenient_count_is_passed_over(rim, count):
    """Going through all counts one by one finds the same neighbours."""
    above = next(n for n in range(count, 10 * count + 100) if slice_cap(rim, n).total == n)
    below = next((n for n in range(count - 1, 4, -1) if slice_cap(rim, n).total == n), None)
    assert convenient_slices(rim, count).total == above
    found = convenient_below(rim, count)
    assert (found and found.total) == below


@settings(max_examples=30, deadline=None)
@given(rim=st.floats(0.1, 1.5), count=st.integers(6, 5000))
def test_the_last_slice_ends_on_the_rim(rim, count):
    """Units of a convenient count fill the cap exactly: Σ j · ω = 2π (1 − cos θ_max)."""
    slices = convenient_slices(rim, count)
    unit = 2 * pi * (1 - cos(rim)) / slices.total
    assert unit * sum(slices.counts) == pytest.approx(2 * pi * (1 - cos(rim)), rel=1e-12)
    assert slices.angles[-1] < rim
    assert list(slices.counts) == sorted(slices.counts)
