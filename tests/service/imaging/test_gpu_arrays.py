"""Images of a GPU stay there from the first product to the last, and the fit is the one made in memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from steradian.imaging import Iterative, ReconstructionPlan, Volume
from steradian.imaging.engines.array_namespace import like, to_numpy
from steradian.imaging.iterative.fista import Fista
from steradian.imaging.iterative.ista import IterativeThresholding
from steradian.imaging.operators import ForwardOperator
from steradian.imaging.signal.bandwidth import sinc_upsample
from support.flat import flat_operator, flat_plan
from support.remote import Remote

SIDE = 1e-3
RNG = np.random.default_rng(5)
COMMON: dict[str, Any] = {
    "samples": 24, "aperture": SIDE, "modes": 12, "sampling_interval": 8e-9, "sound_speed": 1500.0, "threads": 1,
}  # fmt: skip


@dataclass
class Elsewhere:
    """A model, or a plan, of a device: takes and gives its arrays only."""

    inner: Any

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)

    def forward(self, volume: Remote, **how: Any) -> Remote:
        return Remote(self.inner.forward(volume.values, **how))

    def backward(self, traces: Remote, **how: Any) -> Remote:
        return Remote(self.inner.backward(traces.values, **how))

    def run(self, traces: Remote, **how: Any) -> Volume:
        found = self.inner.run(traces.values, **how)
        return Volume(Remote(found.values), found.axes, found.spacing)  # type: ignore[arg-type]


def _problem() -> tuple[ForwardOperator, ReconstructionPlan, np.ndarray]:
    positions = (RNG.random((30, 2)) - 0.5) * SIDE
    model = flat_operator(positions, **COMMON)
    truth = np.zeros(model.volume_shape, np.float32)
    truth[4:7, 5:8, 10:13] = 1.0
    return model, flat_plan(positions, **COMMON), model.forward(truth)


@pytest.mark.parametrize("regularisation", ["thresholding", "total-variation", "sparsity", "tikhonov"])
def test_the_image_is_the_one_found_in_memory(regularisation: Any) -> None:
    model, plan, measured = _problem()
    options = Iterative(regularisation=regularisation, iterations=4, refits=2, discrepancy=None)
    found = []
    for inside in (lambda thing: thing, Elsewhere):
        given: Any = measured.copy() if inside is not Elsewhere else Remote(measured.copy())
        rest = inside(model), given, options, 0.0, None, None
        solution = IterativeThresholding(inside(plan), *rest) if regularisation == "thresholding" else Fista(*rest)
        found.append(solution.run())
    here, there = found
    assert isinstance(there, Remote)
    assert np.linalg.norm(here) > 0
    assert np.linalg.norm(there.get() - here) <= 1e-5 * np.linalg.norm(here)


def test_it_is_refined_where_it_is() -> None:
    values = RNG.standard_normal((5, 6, 16)).astype(np.float32)
    expected = sinc_upsample(values, (2, 2, 3), slice(4, 30))
    found: Any = sinc_upsample(Remote(values), (2, 2, 3), slice(4, 30))  # type: ignore[arg-type]
    assert isinstance(found, Remote)
    np.testing.assert_allclose(found.get(), expected, atol=1e-5)


def test_arrays_go_there_and_back() -> None:
    there = like(np.arange(3.0), Remote(np.zeros(2)))
    assert isinstance(there, Remote)
    np.testing.assert_array_equal(to_numpy(there), np.arange(3.0))
    assert isinstance(like(np.arange(3.0), np.zeros(2)), np.ndarray)
