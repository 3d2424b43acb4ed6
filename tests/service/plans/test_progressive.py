"""A progressive order: stopped after any pass, the scan is a sparse mask of its own."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree

from fabry_perot.simulator.phantoms import pressure, yarn
from steradian import (
    Acquisition,
    ImageGrid,
    InvalidInput,
    Nufft,
    ScanPlan,
    equi_steradian_mask,
    quality,
    reconstruct,
)
from steradian.imaging.geometry import polygons as outlines
from steradian.masks import PointOfInterest, combined_mask, equiangular_mask, poisson_disc_mask


@pytest.fixture(scope="module")
def mask():
    """The paper's."""
    return equi_steradian_mask(13.56e-3, 3.6e-3, 1600)


def test_passes_double_in_size(mask):
    """An eighth, a quarter, a half and all of the points end a pass each."""
    plan = ScanPlan.create(mask=mask, order="progressive")
    assert plan.pass_ends == (201, 402, 803, 1605)
    assert ScanPlan.create(mask=mask, order="snake").pass_ends == (1605,)


def test_every_prefix_is_spread_as_evenly_as_a_mask_of_its_size(mask):
    """After each pass neighbouring directions from the point of interest are nearly equally far apart."""
    plan = ScanPlan.create(mask=mask, order="progressive")
    rays = np.column_stack([mask.positions, np.full(mask.count, mask.depth)])
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    cap = 2 * np.pi * (1 - rays[:, 2].min())
    for end in plan.pass_ends:
        prefix = rays[plan.visit[:end]]
        closest = KDTree(prefix).query(prefix, k=2)[0][:, 1]
        assert closest.min() > 0.6 * np.sqrt(cap / end)
        assert closest.std() / closest.mean() < 0.2


@pytest.mark.long
def test_images_get_better_with_every_pass_and_sooner_than_in_rows(mask):
    """Correlation with the full image rises at 25, 50 and 100 %; a quarter beats the first quarter of rows."""
    traces = pressure(yarn(1), mask.positions, np.arange(896) * 8e-9, 1500.0)

    def image(plan, points):
        prefix, seen = plan.truncated_mask(points, "analytic"), plan.visit[:points]
        acquisition = Acquisition(
            traces[seen],
            prefix.positions,
            weights=prefix.weights,
            dt=8e-9,
            sound_speed=1500.0,
            aperture=mask.aperture,
        )
        volume = reconstruct(acquisition, ImageGrid(160, depth=(2.8e-3, 4.4e-3)), Nufft(tolerance=1e-3))
        return volume.mip("z")

    plan, rows = (ScanPlan.create(mask=mask, order=order) for order in ("progressive", "snake"))
    _, quarter, half, whole = plan.pass_ends
    full = image(plan, whole)
    rho = [quality.correlation(image(plan, points), full) for points in (quarter, half, whole)]
    assert rho[0] < rho[1] < rho[2]
    assert rho[2] == pytest.approx(1)
    assert rho[0] > 0.8
    assert rho[0] > quality.correlation(image(rows, quarter), full) + 0.1


def others():
    """Masks of other arrangements."""
    points = [PointOfInterest(depth=2e-3, count=150, offset=(x, 0)) for x in (-2e-3, 2e-3)]
    return [
        equi_steradian_mask(1e-2, 3e-3, 60, offset=(2e-3, 0)),
        equiangular_mask(1e-2, 2e-3, 100),
        poisson_disc_mask(1e-2, 5e-4),
        combined_mask(1e-2, points),
    ]


@pytest.mark.long
@settings(max_examples=15, deadline=None)
@given(
    mask=st.deferred(lambda: st.sampled_from(others())),
    share=st.floats(0.01, 1),
    weighting=st.sampled_from(["analytic", "voronoi", "uniform"]),
)
def test_truncated_mask_weights_sum_to_its_sensed_area(mask, share, weighting):
    """Weights are given for every prefix, whole passes or not, of any arrangement; none senses more than the mask."""
    plan = ScanPlan.create(mask=mask, order="progressive")
    assert plan.pass_ends[-1] == mask.count
    prefix = plan.truncated_mask(max(1, int(share * mask.count)), weighting)
    assert prefix.weights.min() > 0
    assert abs(prefix.sensed_area / outlines.area(prefix.outline) - 1) < 1e-12
    assert prefix.sensed_area < mask.sensed_area * (1 + 1e-9)


def test_truncated_mask_has_the_first_visited_points(mask):
    plan = ScanPlan.create(mask=mask, order="snake")
    np.testing.assert_array_equal(plan.truncated_mask(201).positions, mask.positions[plan.visit[:201]])


def test_truncated_mask_count_out_of_range_is_refused(mask):
    """A prefix outside of 1 to M is refused with that range."""
    with pytest.raises(InvalidInput, match="1 to 1605"):
        ScanPlan.create(mask=mask).truncated_mask(0)
