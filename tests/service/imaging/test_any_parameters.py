"""Whatever finite numbers a reconstruction is asked for: an error that names the field, or a finite image."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from steradian.core.exceptions import InvalidInput
from steradian.imaging import Iterative, Window
from support.flat import flat_reconstruct

SIDE = st.floats(1e-4, 0.1)
MODES = st.integers(2, 20)
NEEDED: dict[str, st.SearchStrategy[Any]] = {
    "sampling_interval": st.floats(1e-10, 1e-5),
    "sound_speed": st.floats(300, 6000),
    "aperture": st.one_of(SIDE, st.tuples(SIDE, SIDE)),
    "modes": st.one_of(MODES, st.tuples(MODES, MODES)),
}
OPTIONAL: dict[str, st.SearchStrategy[Any]] = {
    "upsampling": st.integers(1, 3),
    "depth_range": st.tuples(st.floats(0, 1e-3), st.floats(0, 1e-3)),
    "method": st.sampled_from(["nedner", "ner", "linear", "nearest", "interpolated"]),
    "tolerance": st.sampled_from([1e-1, 1e-4, 1e-8, 1e-12]),
    "time_zero": st.floats(-1e-6, 1e-6),
    "time_padding": st.floats(1, 3),
    "lateral_padding": st.floats(1, 3),
    "wrap": st.booleans(),
    "highest_frequency": st.one_of(st.just("signal"), st.floats(1e5, 1e9)),
    "depth_step": st.floats(1e-6, 1e-2),
    "scale": st.floats(-1e3, 1e3),
    "dtype": st.sampled_from([None, "float32", np.float64, "float16"]),
}
ANY = st.floats(allow_nan=False, allow_infinity=False)
FIT: dict[str, st.SearchStrategy[Any]] = {
    "regularisation": st.sampled_from(["thresholding", "total-variation", "sparsity", "tikhonov", "none"]),
    "strength": st.one_of(st.none(), ANY),
    "non_negative": st.booleans(),
    "iterations": st.integers(1, 3),
    "discrepancy": st.one_of(st.none(), ANY),
    "noise": st.one_of(st.none(), ANY),
    "highest_frequency": st.one_of(st.none(), ANY),
    "refits": st.integers(0, 2),
}
ODD = st.dictionaries(
    st.sampled_from(
        [
            *NEEDED, "upsampling", "tolerance", "time_zero", "time_padding", "lateral_padding", "scale",
            "highest_frequency", "depth_step",
        ]
    ),
    ANY,
    max_size=1,
)  # fmt: skip
WINDOW = st.tuples(st.sampled_from(["kaiser-bessel", "semicircle"]), st.integers(1, 50), st.floats(0.9, 4), SIDE)
FITTED = {  # narrower, for most of them to be fitted
    **NEEDED,
    "sampling_interval": st.floats(5e-9, 5e-8),
    "aperture": st.floats(2e-3, 2e-2),
}
LEFT_OUT = ("method", "window", "time_padding", "highest_frequency", "depth_step", "dtype", "depth_range")
LIBRARY = {"sampling_interval": "dt", "depth_range": "depth", "time_zero": "t0"}
"""Names of parameters in the library, by those that tests have."""
KNOWN = {LIBRARY.get(name, name) for name in (*NEEDED, *OPTIONAL, *FIT)} | {
    "max_frequency", "sensors", "samples", "traces", "memory_limit", "width", "oversampling",
}  # fmt: skip


@pytest.mark.long
@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    chosen=st.fixed_dictionaries(NEEDED, optional=OPTIONAL),
    odd=ODD,
    window=st.one_of(st.none(), WINDOW),
    sensors=st.tuples(st.integers(1, 12), st.integers(1, 2), st.integers(0, 2**31), st.booleans()),
    samples=st.integers(4, 140),
)
def test_any_finite_parameters_are_refused_by_name_or_give_a_finite_image(
    chosen: dict[str, Any],
    odd: dict[str, float],
    window: tuple[Any, ...] | None,
    sensors: tuple[int, int, int, bool],
    samples: int,
) -> None:
    count, axes, seed, few = sensors
    random = np.random.default_rng(seed)
    places = random.random((count, axes)) - 0.5
    places = np.round(places * 4) / 4 if few else places  # several at one place, and a grid
    options = {"memory_limit": 1 << 26, **chosen, **odd}
    traces = random.standard_normal((count, samples))
    try:
        if window is not None:
            shape, width, oversampling, beta = window
            options["window"] = Window(shape, width, oversampling, 1000 * beta)
        image = flat_reconstruct(traces, places * np.min(chosen["aperture"]), **options)
    except InvalidInput as error:
        refused = error.field.partition("[")[0]
    else:
        refused = None
        assert np.isfinite(image.values).all()
        assert image.values.shape == tuple(len(image.coordinates(name)) for name in image.names)
    assert refused is None or refused in KNOWN


@pytest.mark.long
@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    chosen=st.fixed_dictionaries(FITTED, optional={k: v for k, v in OPTIONAL.items() if k not in LEFT_OUT}),
    fit=st.fixed_dictionaries({}, optional=FIT),
    odd=ODD.filter(lambda odd: "highest_frequency" not in odd),  # no option of this method
    seed=st.integers(0, 2**31),
)
def test_any_finite_parameters_of_a_fit_are_refused_by_name_or_give_a_finite_image(
    chosen: dict[str, Any], fit: dict[str, Any], odd: dict[str, float], seed: int
) -> None:
    random = np.random.default_rng(seed)
    places = (random.random((6, 1 + seed % 2)) - 0.5) * np.min(chosen["aperture"])
    options = {"memory_limit": 1 << 25, "method": "iterative", **chosen, **odd}
    try:
        image = flat_reconstruct(random.standard_normal((6, 60)), places, iterative=Iterative(**fit), **options)
    except InvalidInput as error:
        refused = error.field.partition("[")[0]
    else:
        refused = None
        assert np.isfinite(image.values).all()
    assert refused is None or refused in KNOWN
