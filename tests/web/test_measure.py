"""What the page draws of a plane is what NumPy says: profile, correlation, depths with signal."""

import numpy as np
import pytest

from support.page_modules import TYPED, modules_of, plane

MODULE = "volume/measurements.js"


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


def test_profile_beyond_image_is_cropped_with_original_distances(modules):
    """Distances stay those from the line's own beginning."""
    script = f"{TYPED} const p = m.profile(given.plane, [-5, 0], [5, 0]); return [p.distances[0], p.distances.at(-1)];"
    first, last = modules.call(MODULE, script, plane=gaussian(0.2))
    assert first == pytest.approx(5 - 2.4, abs=0.04)
    assert last == pytest.approx(5 - 2.4 + 80 * 0.06, abs=0.04)


@pytest.mark.parametrize(("noise", "parts"), [(0.0, [(60, 90)]), (0.04, [(60, 90), (150, 155)]), (0.04, [(0, 230)])])
def test_shown_depths_are_those_of_what_stands_out_of_the_noise(modules, noise, parts):
    """A bright and a five times weaker object lie within; of one that fills the depths there is no crop."""
    shape, spacing, random = (80, 80, 256), (0.1, 0.1, 0.05), np.random.default_rng(4)
    image = np.abs(random.normal(0, noise, shape)).max(axis=1) if noise else np.zeros((80, 256))
    for n, (first, last) in enumerate(parts):
        image[30:33, first:last] += 1 - 0.8 * n
    script = f"""{TYPED} const source = {{shape: given.shape, spacing: given.spacing, origin: [0, 0, 0], flat: false}};
        return m.signalDepths(source, given.plane, 1, 0);"""
    found = modules.call(
        "volume/depth_crop.js", script, plane=plane(image, (0, 0), (0.1, 0.05)), shape=shape, spacing=spacing
    )
    if parts[0][1] == 230:
        assert found is None
        return
    first, last = 0.05 * (parts[0][0] - 0.5), 0.05 * (parts[-1][1] - 0.5)
    margin = max(0.12 * (last - first), (0.25 * 8 - (last - first)) / 2)
    assert found == pytest.approx([first - margin, last + margin], abs=1e-6)


def test_correlation_is_pearson_s(modules):
    one, other = np.random.default_rng(3).normal(100, 1, (2, 500))
    script = "return m.correlation(given.one, given.other);"
    assert modules.call(MODULE, script, one=one, other=one + other) == pytest.approx(
        np.corrcoef(one, one + other)[0, 1]
    )
