"""Sensing spot in requests: amplitude of a ball whose A-lines are means over the spot, by quadrature."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from steradian.core.exceptions import InvalidInput
from steradian.imaging import ElasticFilm, SensingSpot
from steradian.phantoms import Balls, pressure
from steradian.reconstructions.film_response_choice import Film
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.run import reconstruct_in_memory
from steradian.scans.opening import open_recording
from steradian.scans.recording import Recording

SIDE, PITCH, DT, SAMPLES, SPEED, DIAMETER = 24, 80e-6, 15e-9, 110, 1500.0, 180e-6


def test_spot_multiplies_the_films_response() -> None:
    found = Film.create(kind="elastic", spot={"diameter": 1e-4, "profile": "top-hat"}).correction()
    assert found is not None
    assert found.response == SensingSpot(1e-4, "top-hat", ElasticFilm())
    found = Film.create(spot={"diameter": 1e-4}, max_gain=5.0).correction()
    assert found is not None
    assert (found.response, found.max_gain) == (SensingSpot(1e-4, "gaussian"), 5.0)
    assert Film.create(spot={"profile": "top-hat"}).correction() is None
    (note,) = Film.create(kind="simulated", spot={"diameter": 1e-4}).notes("ideal")
    assert note == "the scan's film was ideal: nothing but the spot was corrected"


@pytest.mark.parametrize(
    ("spot", "words"),
    [
        ({"diameter": -1e-4}, r"film.spot.diameter is -0.0001; allowed: at least 1e-07, at most 0.005 \(m\)"),
        ({"profile": "square"}, "film.spot.profile is square; allowed: .*'gaussian' or 'top-hat'"),
    ],
)
def test_impossible_spot_is_refused_with_field_value_and_range(spot: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidInput, match=words):
        ReconstructionParameters.create(film={"spot": spot})


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A ball as points hear it."""
    path = tmp_path_factory.mktemp("spot") / "scan.npz"
    np.savez(path, p=np.zeros((SAMPLES, SIDE, SIDE), np.float32), dt=DT, dx=PITCH, c=SPEED)
    recording = open_recording(path)
    return replace(recording, traces=heard(recording.positions))


def heard(positions: np.ndarray) -> np.ndarray:
    """Return the A-lines of a ball 0.7 mm below the middle."""
    ball = Balls(np.array([[0, 0, 0.7e-3]]), np.array([60e-6]), np.ones(1))
    return pressure(ball, positions, samples=SAMPLES, sampling_interval=DT, sound_speed=SPEED).astype(np.float32)


@pytest.mark.long
def test_spot_correction_restores_the_amplitude_of_a_point_sensor(recording: Recording) -> None:
    nodes, weights = np.polynomial.legendre.leggauss(6)
    radii, angles = DIAMETER / 2 * np.sqrt((nodes + 1) / 2), 2 * np.pi * np.arange(12) / 12
    averaged = np.zeros(recording.traces.shape, np.float32)
    for radius, weight in zip(radii, weights / 2 / len(angles), strict=True):  # equal areas of a disc
        for angle in angles:
            averaged += weight * heard(recording.positions + radius * np.array([np.cos(angle), np.sin(angle)]))
    spot = ReconstructionParameters.create(film={"spot": {"diameter": DIAMETER, "profile": "top-hat"}})
    top = reconstruct_in_memory(recording, ReconstructionParameters()).values.max()
    seen = replace(recording, traces=averaged)
    assert reconstruct_in_memory(seen, ReconstructionParameters()).values.max() < 0.87 * top
    assert reconstruct_in_memory(seen, spot).values.max() == pytest.approx(top, rel=0.03)
