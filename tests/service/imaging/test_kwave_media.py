"""The forward model beside a full-wave simulation of layers and attenuation (tests/data/README.md)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from steradian.imaging import ATTENUATIONS, AcquisitionGeometry, Compute, ImageGrid, Layer, Medium
from steradian.imaging.operators import ForwardOperator

TISSUE = ATTENUATIONS["soft tissue"]
BOUNDARY = 39.5 * 25e-6


def at_1_mhz(speed: float) -> float:
    """Speed of sound of soft tissue at 1 MHz of that at the frequency 0, by the Kramers–Kronig relation."""
    omega = 2 * np.pi * 1e6
    return float(1 / (1 / speed + 0.75 * 100 / 8.685889638 / omega * np.tan(0.75 * np.pi)))


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "medium", "most"),
    [
        ("layers", Medium([Layer(1480.0, BOUNDARY), Layer(1580.0)]), 0.002),
        ("lossy", Medium([Layer(at_1_mhz(1520.0), attenuation=TISSUE)]), 0.02),
        ("lossy_layer", Medium([Layer(1480.0, BOUNDARY), Layer(at_1_mhz(1580.0), attenuation=TISSUE)]), 0.01),
    ],
)
def test_model_gives_the_a_lines_of_a_full_wave_simulation(name: str, medium: Medium, most: float) -> None:
    with np.load(Path(__file__).parents[2] / "data" / "media_kwave.npz") as file:
        data = dict(file)
    truth = data[name] * float(data["scale"])
    errors = []
    for each in (medium, Medium([Layer(1520.0)])):
        geometry = AcquisitionGeometry(
            data["sensors"], truth.shape[1], dt=float(data["dt"]), medium=each, aperture=320 * float(data["dx"])
        )
        operator = ForwardOperator(geometry, ImageGrid(320, depth=(0.2e-3, 3.2e-3)), compute=Compute(device="cpu"))
        axes = operator.geometry.axes()
        squares = (axes.x[:, None] - data["centre"][0]) ** 2 + (axes.z - data["centre"][1]) ** 2
        errors.append(np.linalg.norm(operator.forward(np.exp(-squares / 2 / data["size"] ** 2)) - truth))
    assert errors[0] <= most * np.linalg.norm(truth)
    assert errors[1] > 0.1 * np.linalg.norm(truth)
