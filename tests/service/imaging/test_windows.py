"""Windows keep the tolerance that they were chosen for."""

from __future__ import annotations

import pytest

from steradian.imaging.transforms.sizes import lateral_grid, time_grid
from steradian.imaging.transforms.windows import Shape, choose


@pytest.mark.parametrize("shape", ["kaiser-bessel", "semicircle"])
@pytest.mark.parametrize("tolerance", [1e-2, pytest.param(2.3e-13, marks=pytest.mark.long)])
def test_no_window_is_taken_that_misses_the_tolerance(shape: Shape, tolerance: float) -> None:
    for oversampling in (1.2, 1.5):
        window = choose(shape, tolerance, oversampling)
        assert window is None or window.error() < tolerance
    # ten million sensors want the narrowest stencil, three the smallest grid
    for sensors in (3, 10**7):
        assert lateral_grid((24, 18), sensors, shape, tolerance)[1].error() < tolerance
    for record in (100, 10**6):
        assert time_grid(100, record, shape, tolerance)[1].error() < tolerance
