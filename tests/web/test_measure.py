"""What the page measures on a plane is what NumPy and closed forms say."""

import math

import numpy as np
import pytest

from steradian.quality import contrast_to_noise
from support.page_modules import TYPED, modules_of, plane

MODULE = "volume/measurements.js"
FWHM = 2 * math.sqrt(2 * math.log(2))


@pytest.fixture(scope="module")
def modules(chromium, service):
    with modules_of(chromium, service) as modules:
        yield modules


def gaussian(sigma, centre=(0.31, -0.17), shape=(81, 64), spacing=(0.06, 0.07), base=0.0):
    """A round Gaussian of height 1 on a plane, and the plane."""
    origin = (-2.4, -2.2)
    a, b = (o + s * np.arange(n) for o, s, n in zip(origin, spacing, shape, strict=True))
    r2 = (a[:, None] - centre[0]) ** 2 + (b[None, :] - centre[1]) ** 2
    return plane(base + np.exp(-r2 / (2 * sigma**2)), origin, spacing)


@pytest.mark.parametrize("angle", [0, 33, 90, 140])
@pytest.mark.parametrize("sigma", [0.1, 0.2])
def test_a_peak_is_as_wide_as_it_is(modules, angle, sigma):
    """A line at any angle through a Gaussian three voxels wide or more finds width, place, height and base."""
    way = np.array([math.cos(math.radians(angle)), math.sin(math.radians(angle))])
    ends = [list(np.array([0.31, -0.17]) + side * 1.5 * way) for side in (-1, 1)]
    script = f"{TYPED} return m.fwhm(m.profile(given.plane, ...given.ends));"
    found = modules.call(MODULE, script, plane=gaussian(sigma, base=0.4), ends=ends)
    assert found["width"] == pytest.approx(FWHM * sigma, rel=0.03)
    assert found["centre"] == pytest.approx(1.5, abs=0.01)
    assert found["base"] == pytest.approx(0.4, abs=0.01)
    assert found["height"] == pytest.approx(1, abs=0.03)


def test_the_width_s_error_is_its_scatter(modules):
    """What a width is said to be uncertain by is what widths of noisy copies of one peak scatter by."""
    random = np.random.default_rng(5)
    x = np.arange(-2, 2, 0.05)
    noisy = np.exp(-(x**2) / (2 * 0.25**2)) + random.normal(0, 0.03, (400, x.size))
    script = "return given.noisy.map((values) => m.fwhm({distances: Float64Array.from(given.x), values}));"
    found = modules.call(MODULE, script, x=x, noisy=noisy)
    widths, errors = (np.array([each[name] for each in found]) for name in ("width", "error"))
    assert 0.6 < np.median(errors) / widths.std() < 1.5
    assert np.median(widths) == pytest.approx(FWHM * 0.25, rel=0.1)


@pytest.mark.parametrize(
    "values", [[0, 1, 2, 3, 4], [4, 3, 2, 1, 0], [1, 1, 1, 1], [-3, -2, -3, -4], [1, 2], [0, 0, 0]]
)
def test_fwhm_of_profile_without_half_maximum_is_null(modules, values):
    script = (
        "const values = Float64Array.from(given.values); return m.fwhm({distances: values.map((_, n) => n), values});"
    )
    assert modules.call(MODULE, script, values=values) is None


def test_a_short_line_does_not_know_its_error(modules):
    """A line that ends where the peak does has a width, but nothing that tells the noise."""
    x = np.linspace(-0.5, 0.5, 41)
    script = "return m.fwhm({distances: Float64Array.from(given.x), values: Float64Array.from(given.values)});"
    found = modules.call(MODULE, script, x=x, values=np.exp(-(x**2) / (2 * 0.25**2)))
    assert found["error"] is None
    assert found["width"] == pytest.approx(FWHM * 0.25, rel=0.01)


def test_profile_beyond_image_is_cropped_with_original_distances(modules):
    """Distances stay those from the line's own beginning."""
    script = f"{TYPED} const p = m.profile(given.plane, [-5, 0], [5, 0]); return [p.distances[0], p.distances.at(-1)];"
    first, last = modules.call(MODULE, script, plane=gaussian(0.2))
    assert first == pytest.approx(5 - 2.4, abs=0.04)
    assert last == pytest.approx(5 - 2.4 + 80 * 0.06, abs=0.04)


def test_statistics_are_numpy_s(modules):
    """Count, mean, deviation and extremes are those of the voxels whose centres lie in the rectangle."""
    values = np.random.default_rng(1).normal(1e4, 1, (40, 30)).astype(np.float32)
    script = f"{TYPED} return m.statistics(given.plane, {{from: [0.95, 0.2], to: [0.3, 1.45]}});"
    found = modules.call(MODULE, script, plane=plane(values.astype(float), (0, 0), (0.1, 0.05)))
    inside = values[3:10, 4:30].astype(float)
    expected = {"count": inside.size, "mean": inside.mean(), "deviation": inside.std(), "area": inside.size * 0.005}
    expected |= {"least": inside.min(), "greatest": inside.max()}
    assert found == pytest.approx(expected, rel=1e-9)
    nowhere = f"{TYPED} return m.statistics(given.plane, {{from: [7, 7], to: [8, 8]}});"
    assert modules.call(MODULE, nowhere, plane=plane(values.astype(float), (0, 0), (0.1, 0.05))) is None


def test_contrast_is_the_service_s(modules):
    """A region against its background has the contrast-to-noise ratio of steradian.quality."""
    image = np.random.default_rng(2).normal(0, 1, (20, 20)).astype(np.float32).astype(float)
    image[:8] += 5
    script = f"""{TYPED} const of = (from, to) => m.statistics(given.plane, {{from, to}});
        return m.contrastToNoise(of([0, 0], [7, 19]), of([8, 0], [19, 19]));"""
    inside = np.arange(20)[:, None] * np.ones(20) < 8
    assert modules.call(MODULE, script, plane=plane(image, (0, 0), (1, 1))) == pytest.approx(
        contrast_to_noise(image, inside), rel=1e-6
    )


def test_correlation_is_pearson_s(modules):
    one, other = np.random.default_rng(3).normal(100, 1, (2, 500))
    script = "return m.correlation(given.one, given.other);"
    assert modules.call(MODULE, script, one=one, other=one + other) == pytest.approx(
        np.corrcoef(one, one + other)[0, 1]
    )
