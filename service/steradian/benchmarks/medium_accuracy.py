"""Error of the forward model of layers, attenuation and sensing spot, and that of its adjoint."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from fabry_perot.simulator.phantoms import Balls, initial_pressure
from steradian.core.progress import Progress
from steradian.imaging import (
    ATTENUATIONS,
    AcquisitionGeometry,
    Compute,
    ElasticFilm,
    FilmResponse,
    ImageGrid,
    Layer,
    Medium,
    SensingSpot,
)
from steradian.imaging.operators import ForwardOperator
from steradian.phantoms import averaged_over_spot, layered_pressure

Row: TypeAlias = dict[str, Any]
_SIDE, _INTERVAL, _SAMPLES, _MODES, _SPOT = 4e-3, 20e-9, 160, 96, 100e-6
_DEPTHS, _BALL = (0.5e-3, 2.5e-3), Balls(np.array([(0.2e-3, -0.1e-3, 1.7e-3)]), np.array([60e-6]), np.ones(1))


class MediumCase(NamedTuple):
    """Case of the benchmark: name, medium, spot, and whether there are A-lines in closed form of balls."""

    name: str
    medium: Medium
    response: FilmResponse | None
    comparable: bool


def medium_cases() -> list[MediumCase]:
    """Return the cases: layers, attenuation and spot each by itself, and all with a film's response."""
    tissue, water = ATTENUATIONS["soft tissue"], ATTENUATIONS["water"]
    spot = SensingSpot(_SPOT, "top-hat")
    return [
        MediumCase("layers", _layered(None, None), None, True),
        MediumCase("attenuation", Medium([Layer(1500.0, attenuation=tissue)]), None, True),
        MediumCase("spot", Medium([Layer(1500.0)]), spot, True),
        MediumCase("layers, attenuation, spot", _layered(water, tissue), spot, True),
        MediumCase("all, film response", _layered(water, tissue), SensingSpot(_SPOT, "top-hat", ElasticFilm()), False),
    ]


def _layered(above: Any, below: Any) -> Medium:
    return Medium([Layer(1480.0, 1e-3, 1000.0, above), Layer(1580.0, None, 1000.0, below)])


def medium_accuracy(*, progress: Progress | None = None) -> list[Row]:
    """Measure the model's A-lines of a ball against rays and quadrature, and the adjoint in float64.

    Parameters
    ----------
    progress
        Called before each row.

    Returns
    -------
    list of dict
        As :func:`.accuracy.accuracy`, with the name of the case as ``method``. ``error`` is the relative l2 error of
        A-lines at the tolerance 1e-4; None with a film's response, which has no closed form. ``adjoint`` is
        |⟨A f, g⟩ − ⟨f, Aᵀ g⟩| over ‖A f‖·‖g‖.
    """
    cases, rows = medium_cases(), []
    for i, case in enumerate(cases):
        if progress is not None:
            progress("medium", i, len(cases))
        rows.append(_row(case))
    if progress is not None:
        progress("medium", len(cases), len(cases))
    return rows


def _row(case: MediumCase) -> Row:
    rng = np.random.default_rng(0)
    where = rng.uniform(-_SIDE / 2, _SIDE / 2, (200, 2))
    geometry = AcquisitionGeometry(where, _SAMPLES, dt=_INTERVAL, medium=case.medium, aperture=_SIDE)
    error = None
    if case.comparable:
        model = _model(geometry, case, _MODES, "float32")
        axes = model.geometry.axes()
        assert axes.y is not None  # noqa: S101 - of a plane
        found = model.forward(initial_pressure(_BALL, axes.x, axes.y, axes.z))
        truth = _truth(case, where)
        error = float(np.linalg.norm(found - truth) / np.linalg.norm(truth))
    model = _model(geometry, case, 16, "float64")
    volume, traces = rng.standard_normal(model.volume_shape), rng.standard_normal(model.trace_shape)
    there, back = model.forward(volume), model.backward(traces)
    gap = abs(float(np.vdot(there, traces)) - float(np.vdot(volume, back)))
    return {
        "sensors": "anywhere",
        "modes": f"{_MODES}×{_MODES}",
        "samples": _SAMPLES,
        "method": f"model: {case.name}",
        "tolerance": None,
        "window": "kaiser-bessel",
        "dtype": "float32",
        "error": error,
        "adjoint": gap / float(np.linalg.norm(there) * np.linalg.norm(traces)),
    }


def _model(geometry: AcquisitionGeometry, case: MediumCase, modes: int, dtype: str) -> ForwardOperator:
    compute = Compute(device="cpu", dtype=dtype)
    return ForwardOperator(geometry, ImageGrid(modes, depth=_DEPTHS), response=case.response, compute=compute)


def _truth(case: MediumCase, where: NDArray[np.float64]) -> NDArray[np.float64]:
    def simulate(positions: NDArray[np.float64]) -> NDArray[np.float64]:
        return layered_pressure(_BALL, positions, case.medium, samples=_SAMPLES, sampling_interval=_INTERVAL)

    if case.response is None:
        return simulate(where)
    return averaged_over_spot(simulate, where, diameter=_SPOT, profile="top-hat")
