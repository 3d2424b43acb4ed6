"""Windows keep the tolerance that they were chosen for."""

from __future__ import annotations

import numpy as np
import pytest

from steradian.imaging.transforms.grid_sizes import lateral_grid, time_grid
from steradian.imaging.transforms.windows import Shape, kaiser_bessel, narrowest_window


@pytest.mark.parametrize("shape", ["kaiser-bessel", "semicircle"])
@pytest.mark.parametrize("tolerance", [1e-2, pytest.param(2.3e-13, marks=pytest.mark.long)])
def test_no_window_is_taken_that_misses_the_tolerance(shape: Shape, tolerance: float) -> None:
    for oversampling in (1.2, 1.5):
        window = narrowest_window(shape, tolerance, oversampling)
        assert window is None or window.error() < tolerance
    # ten million sensors want the narrowest stencil, three the smallest grid
    for sensors in (3, 10**7):
        assert lateral_grid((24, 18), sensors, shape, tolerance)[1].error() < tolerance
    for record in (100, 10**6):
        assert time_grid(100, record, shape, tolerance)[1].error() < tolerance


@pytest.mark.parametrize("width", [4, 5, 6, 7])
@pytest.mark.parametrize("accuracy", [1e-2, 1e-3, 1e-4, 1e-5])
def test_taps_are_their_polynomials_also_where_a_coefficient_is_nothing(
    width: int, accuracy: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What symmetry makes 0 is rounded to some 1e-17 or to 0, as processor and build have it."""
    fit = np.polynomial.chebyshev.chebfit

    def rounded(*given: object) -> np.ndarray:
        found = fit(*given)
        return np.where(np.abs(found) < 1e-12, 0.0, found)

    monkeypatch.setattr(np.polynomial.chebyshev, "chebfit", rounded)
    window = kaiser_bessel(width / 2, 2.0)
    powers = window.polynomials(accuracy)
    fraction = np.linspace(0, 1, 50)
    drawn = np.polynomial.polynomial.polyval(2 * fraction - 1, powers.T)
    assert np.abs(drawn.T - window.taps(fraction)).max() < 1.5 * accuracy
