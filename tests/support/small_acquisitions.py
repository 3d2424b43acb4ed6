"""Small acquisitions for tests of operators of other libraries, in media of every kind."""

from __future__ import annotations

import numpy as np

from steradian.imaging import AcquisitionGeometry, Attenuation, ImageGrid, Layer, Medium

SIDE, DT, BEGINS, SAMPLES = 2e-3, 2e-8, 1.1e-7, 16
PLACES = (np.random.default_rng(0).random((5, 2)) - 0.5) * 0.9 * SIDE
GRID = ImageGrid(modes=(5, 4), depth=(1e-4, 3e-4))
MEDIA = {
    "lossless": Medium([Layer(1500.0)]),
    "attenuating": Medium([Layer(1500.0, attenuation=Attenuation(0.75, 1.5))]),
    "layers": Medium([Layer(1480.0, thickness=2.3e-4), Layer(1540.0, attenuation=Attenuation(0.75, 1.5))]),
}


def small_geometry(medium: str = "lossless") -> AcquisitionGeometry:
    """Five sensors of different sensitivity and weight, sixteen samples."""
    return AcquisitionGeometry(
        PLACES, SAMPLES, dt=DT, t0=BEGINS, aperture=SIDE, medium=MEDIA[medium], weights=np.linspace(0.5, 1, 5) * 1e-7,
        sensitivity=np.linspace(1, 2, 5),
    )  # fmt: skip
