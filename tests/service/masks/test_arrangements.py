"""What holds for masks of every arrangement."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter
from scipy.spatial import KDTree

from steradian import InvalidInput
from steradian.imaging.geometry import polygons as outlines
from steradian.masks import (
    Arrangement,
    Combined,
    Equiangular,
    EquiSteradian,
    Grid,
    Hexagonal,
    PointOfInterest,
    Points,
    PoissonDisc,
    Random,
    ScannerGrid,
    Subset,
    equiangular_mask,
    grid_mask,
    hexagonal_mask,
    poisson_disc_mask,
    random_mask,
)

weightings = st.sampled_from(["analytic", "voronoi", "uniform"])
seeds = st.integers(0, 1000)


@st.composite
def arrangements(draw):
    """Draw any arrangement with sensible parameters."""
    aperture, weighting = draw(st.floats(2e-3, 0.1)), draw(weightings)
    common = {"aperture": aperture, "weighting": weighting}
    depth, count = draw(st.floats(0.1, 2)) * aperture, draw(st.integers(5, 300))
    place = draw(st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)))
    offset = (place[0] * aperture, place[1] * aperture)
    focus = {"depth": depth, "count": count, "offset": offset}
    step = draw(st.floats(0.05, 0.5)) * aperture
    grid = draw(st.none() | st.just(ScannerGrid(count=64, interval=aperture / 64)))
    points = (np.random.default_rng(draw(seeds)).random((count, 2)) - 0.5) * aperture
    return draw(
        st.sampled_from(
            [
                EquiSteradian(**common, **focus, grid=grid),
                Equiangular(**common, **(focus | {"offset": offset[0]}), grid=grid),
                Grid(**common, count=max(1, int(aperture / step)), interval=step, centred=draw(st.booleans())),
                Hexagonal(**common, interval=step),
                Random(**common, count=count, seed=draw(seeds)),
                PoissonDisc(**common, spacing=step, seed=draw(seeds)),
                Combined(
                    **common,
                    points_of_interest=(PointOfInterest(**focus), PointOfInterest(depth=depth / 2, count=20)),
                    grid=grid,
                ),
                Points(**common, positions=points),
                Subset(
                    mask=Points(aperture=aperture, positions=points).build(),
                    indices=tuple(range(0, count, 3)),
                    weighting=weighting,
                ),
            ]
        )
    )


@pytest.mark.long
@settings(max_examples=20, deadline=None)
@given(arrangement=arrangements())
def test_a_mask_is_sound_and_can_be_made_again(arrangement):
    """Points lie in the aperture, weights are positive and sum to the outline, the parameters give the same mask."""
    mask = arrangement.build()
    assert np.abs(mask.positions).max() <= mask.aperture / 2 * (1 + 1e-12)
    assert mask.outline is not None
    assert abs(mask.sensed_area / outlines.area(mask.outline) - 1) < 1e-12
    assert mask.weights.min() > 0
    assert mask.arrangement["arrangement"] == arrangement.arrangement
    again = TypeAdapter(Arrangement).validate_json(arrangement.model_dump_json()).build()
    assert again.id == mask.id


def test_a_grid_may_be_centred():
    """An even grid lies on the modes' places or symmetric to the centre."""
    assert grid_mask(1e-2, 4, 1e-3).positions.min() == pytest.approx(-2e-3)
    centred = grid_mask(1e-2, 4, 1e-3, centred=True).positions
    np.testing.assert_allclose([centred.min(), centred.max()], [-1.5e-3, 1.5e-3])


def test_a_hexagonal_lattice_has_six_neighbours_at_the_interval():
    """Inner points see six neighbours at one distance."""
    mask = hexagonal_mask(1e-2, 5e-4)
    distance = KDTree(mask.positions).query(mask.positions[np.abs(mask.positions).max(axis=1) < 4e-3], k=7)[0]
    np.testing.assert_allclose(distance[:, 1:], 5e-4, rtol=1e-9)


@settings(max_examples=15, deadline=None)
@given(spacing=st.floats(0.02, 0.5), seed=seeds)
def test_poisson_disc_points_keep_their_distance_and_leave_no_gap(spacing, seed):
    """No two points are closer than the spacing, and hardly any place is two spacings from the nearest."""
    mask = poisson_disc_mask(1.0, spacing, seed=seed)
    tree = KDTree(mask.positions)
    if mask.count > 1:
        assert tree.query(mask.positions, k=2)[0][:, 1].min() >= spacing * (1 - 1e-12)
    probes = np.random.default_rng(seed).random((2000, 2)) - 0.5
    assert np.quantile(tree.query(probes)[0], 0.99) < 2 * spacing


def test_the_same_seed_gives_the_same_points():
    """Random arrangements are reproducible and differ between seeds."""
    assert random_mask(1e-2, 50, seed=3).id == random_mask(1e-2, 50, seed=3).id
    assert random_mask(1e-2, 50, seed=3).id != random_mask(1e-2, 50, seed=4).id
    assert poisson_disc_mask(1e-2, 1e-3, seed=3).id == poisson_disc_mask(1e-2, 1e-3, seed=3).id


def test_the_papers_line_has_the_papers_weight_ratio():
    """32 of 1,024 sensors for a point at depth 128: the outermost weighs 17 times the middle (paper, section 5)."""
    grid = ScannerGrid(count=1024, interval=1e-4)
    mask = equiangular_mask(1024e-4, 128e-4, 32, grid=grid, weighting="analytic")
    assert mask.positions.shape == (32, 1)
    assert mask.weight_ratio == pytest.approx(17, abs=1)
    assert mask.weights.sum() == pytest.approx(1024e-4, rel=1e-12)


@settings(max_examples=20, deadline=None)
@given(depth=st.floats(1e-3, 2e-2), offset=st.floats(-5e-3, 5e-3), count=st.integers(3, 200))
def test_sensors_of_a_line_enclose_equal_angles(depth, offset, count):
    """Neighbours are seen under the same angle, from one end of the line to the other."""
    mask = equiangular_mask(1e-2, depth, count, offset=offset)
    angles = np.arctan((mask.positions[:, 0] - offset) / depth)
    np.testing.assert_allclose(np.diff(angles), np.ptp(angles) / (count - 1), rtol=1e-6)
    np.testing.assert_allclose([mask.positions.min(), mask.positions.max()], [-5e-3, 5e-3], rtol=1e-12)


@pytest.mark.long
def test_several_points_of_interest_are_each_sensed_as_asked():
    """Near each point of interest the combined mask is as dense as one for it alone; far points are shared."""
    focus = [PointOfInterest(depth=2e-3, count=300, offset=(x, 0.0)) for x in (-3e-3, 3e-3)]
    mask = Combined(aperture=13.56e-3, points_of_interest=tuple(focus)).build()
    for point in focus:
        alone = EquiSteradian(aperture=13.56e-3, **dict(point)).build()
        near = [np.linalg.norm(m.positions - point.offset, axis=1) < 2e-3 for m in (mask, alone)]
        assert near[0].sum() == near[1].sum()
    assert mask.count < 600
    assert len(mask.points_of_interest) == 2
    assert KDTree(mask.positions).query(mask.positions, k=2)[0][:, 1].min() > 100e-6


@pytest.mark.parametrize(
    ("build", "field", "allowed"),
    [
        (lambda: Grid.create(aperture=1e-2, count=0, interval=1e-3), "count", "at least 1"),
        (lambda: grid_mask(1e-2, 11, 1e-3), "interval", "at most aperture / count"),
        (lambda: Hexagonal.create(aperture=1e-2, interval=-1), "interval", "> 0"),
        (lambda: Random.create(aperture=1e-2, count=10**7), "count", "at most"),
        (lambda: Random.create(aperture=1e-2, count=10, seed=-1), "seed", "at least 0"),
        (lambda: poisson_disc_mask(1e-2, 1e-7), "spacing", "a million points"),
        (lambda: equiangular_mask(1e-2, 1e-3, 10, offset=6e-3), "offset", "±0.005"),
        (lambda: equiangular_mask(1e-2, 1e-3, 1), "count", "at least 2"),
        (lambda: Combined.create(aperture=1e-2, points_of_interest=()), "points_of_interest", "at least 1"),
        (lambda: PointOfInterest.create(depth=0, count=9), "depth", "> 0"),
        (lambda: ScannerGrid.create(count=0, interval=1), "count", "at least 1"),
    ],
)
def test_bad_parameters_name_field_and_range(build, field, allowed):
    """Every arrangement refuses a wrong parameter with its name and what is allowed."""
    with pytest.raises(InvalidInput) as refused:
        build()
    assert refused.value.field == field
    assert allowed in refused.value.allowed


@pytest.mark.parametrize("interval", [1e-9, 1e-300])
def test_a_lattice_that_no_memory_holds_is_refused_by_its_interval(interval):
    """As many points as the largest grid has are allowed."""
    with pytest.raises(InvalidInput, match=r"interval .* at least 2\.\d+e-06 \(m\)"):
        hexagonal_mask(1e-2, interval)
