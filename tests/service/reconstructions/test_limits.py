"""Limits and names of the request parameters against those of the library's value objects."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import MODES
from steradian.imaging import Acquisition, ElasticFilm, ImageGrid, InverseFilter, Iterative, Nufft
from steradian.masks import equi_steradian_mask
from steradian.reconstructions.parameters import ReconstructionParameters, default_modes
from steradian.reconstructions.pipeline.resolve import request_field_names, resolve_setup
from steradian.reconstructions.pipeline.run import reconstruct_in_memory
from steradian.scans.recording import Recording

SCHEMA = ReconstructionParameters.model_json_schema()
MASK = equi_steradian_mask(10e-3, 3e-3, 60)
LIBRARY: dict[str, Callable[[Any], object]] = {
    "modes": ImageGrid,
    "upsampling": lambda value: ImageGrid(8, upsampling=value),
    "time_padding": lambda value: ImageGrid(8, time_padding=value),
    "lateral_padding": lambda value: ImageGrid(8, lateral_padding=value),
    "depth_step": lambda value: ImageGrid(8, depth_step=value),
    "tolerance": lambda value: Nufft(tolerance=value),
    "sound_speed": lambda value: Acquisition(np.zeros((1, 8)), MASK, dt=8e-9, sound_speed=value),
    "film.max_gain": lambda value: InverseFilter(ElasticFilm(), value),
}


def limits(field: str) -> dict[str, float]:
    """Return the limits that the JSON schema has for a field."""
    part, _, name = field.rpartition(".")
    schema = SCHEMA["$defs"]["Film"] if part else SCHEMA
    described = schema["properties"][name]
    numeric = next((each for each in described.get("anyOf", ()) if each["type"] != "null"), described)
    return {key: value for key, value in numeric.items() if "inimum" in key or "aximum" in key}


@pytest.mark.parametrize("field", LIBRARY)
def test_library_has_the_limits_of_the_http_schema(field: str) -> None:
    make, bounds = LIBRARY[field], limits(field)
    assert len(bounds) == 2
    for name, value in bounds.items():
        beyond = value + (1 if name.endswith("aximum") else -1) * max(1e-13, abs(value) * 1e-3)
        if field in ("modes", "upsampling"):
            beyond = value + (1 if name.endswith("aximum") else -1)
        if name.startswith("exclusive"):
            beyond = value
        else:
            make(value)
        with pytest.raises(InvalidInput, match=field.rpartition(".")[2]):
            make(beyond)


def test_every_limited_number_of_requests_is_compared_with_the_library() -> None:
    own = {name for name in SCHEMA["properties"] if limits(name)}
    assert own == {name for name in LIBRARY if "." not in name}


def test_default_modes_are_within_the_limits() -> None:
    assert default_modes(None, 13.56e-3) == 226
    assert default_modes(5000, 0.1) == default_modes(None, 1.0) == MODES.high


@pytest.fixture
def recording() -> Recording:
    return Recording(
        traces=np.random.default_rng(0).standard_normal((MASK.count, 96)).astype(np.float32),
        positions=MASK.positions,
        sampling_interval=16e-9,
        aperture=MASK.aperture,
        weights=MASK.weights,
        sound_speed=1500.0,
        scale=1.0,
        time_zero=0.0,
        grid=None,
        depth=None,
        planned=MASK.count,
        provenance={},
    )


@pytest.mark.parametrize(
    ("field", "change"),
    [
        ("depth_range", {"depth_range": (0.0, 0.1)}),
        ("highest_frequency", {"highest_frequency": 1.0}),
        ("highest_frequency", {"method": "iterative", "iterative": {"highest_frequency": 1.0}}),
        ("depth_step", {"depth_step": 1e-9}),
        ("method", {"method": "ner"}),
        ("window", {"method": "iterative", "window": "semicircle"}),
        ("time_padding", {"method": "iterative", "time_padding": 2.0}),
        ("correction.max_gain", {"method": "iterative", "film": {"kind": "elastic", "max_gain": 20}}),
    ],
)
def test_errors_of_a_reconstruction_name_the_field_of_the_request(
    recording: Recording, field: str, change: dict[str, Any]
) -> None:
    parameters = ReconstructionParameters.create(modes=16, device="cpu", **change)
    with pytest.raises(InvalidInput) as caught:
        reconstruct_in_memory(recording, parameters)
    assert caught.value.field == field


@pytest.mark.parametrize(
    ("library", "request_field"),
    [
        ("depth", "depth_range"),
        ("max_frequency", "highest_frequency"),
        ("dt", "sampling_interval"),
        ("t0", "time_zero"),
        ("sensors[3]", "positions[3]"),
        ("modes", "modes"),
    ],
)
def test_request_field_names_renames_library_fields(library: str, request_field: str) -> None:
    with pytest.raises(InvalidInput, match="9; allowed: less") as caught, request_field_names():
        raise InvalidInput(library, 9, "less")
    assert caught.value.field == request_field


def test_setup_has_all_parameters_of_a_request(recording: Recording) -> None:
    parameters = ReconstructionParameters.create(
        modes=20, upsampling=2, depth_range=(1e-3, None), sound_speed=1480.0, tolerance=1e-3, lateral_padding=1.5,
        time_padding=2.0, highest_frequency=20e6, depth_step=3e-5, device="cpu", method="linear",
        window="semicircle", film={"kind": "rule"}, conditioning={"delay": 1e-6},
    )  # fmt: skip
    geometry, grid, method, compute = resolve_setup(recording, parameters)
    assert (geometry.samples, geometry.dt, geometry.sound_speed) == (96, 16e-9, 1480.0)
    assert geometry.t0 == pytest.approx(1e-6)
    assert (grid.modes, grid.upsampling, grid.lateral_padding, grid.time_padding) == (20, 2, 1.5, 2.0)
    assert grid.depth is not None
    assert grid.depth[0] == 1e-3
    assert grid.depth_step == 3e-5
    assert (method.name, method.tolerance, compute.device) == ("linear", 1e-3, "cpu")
    assert not isinstance(method, Iterative)
    assert (method.window, method.max_frequency) == ("semicircle", 20e6)
    assert method.correction is not None
    fitted = resolve_setup(
        recording, ReconstructionParameters.create(method="iterative", iterative={"iterations": 7})
    ).method
    assert isinstance(fitted, Iterative)
    assert fitted.iterations == 7
