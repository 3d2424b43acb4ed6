"""deepinv physics and pylops: their own checks of a linear operator and its adjoint."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys

import numpy as np
import pytest

import steradian
from steradian.imaging import AcquisitionGeometry, ImageGrid
from steradian.phantoms import pressure, rasterise, yarn
from support.torchvision_operators import define_missing_operators

torch = pytest.importorskip("torch", reason="PyTorch: pip install --no-deps -r constraints-operators.txt")
define_missing_operators()
deepinv = pytest.importorskip("deepinv", reason="deepinv: pip install --no-deps -r constraints-operators.txt")
physics_of = pytest.importorskip("steradian.deepinv").PlanarPhotoacoustics
MASK = steradian.equi_steradian_mask(6e-3, 2e-3, 200)
GEOMETRY = AcquisitionGeometry(MASK, 200, dt=2e-8, sound_speed=1500.0)
GRID = ImageGrid(modes=40, depth=(5e-4, 3e-3))


@pytest.fixture(scope="module")
def physics():
    return physics_of(GEOMETRY, GRID, normalise=True)


def test_it_passes_the_library_s_test_of_adjointness(physics) -> None:
    for dtype, error in ((torch.float32, 1e-4), (torch.float64, 1e-12)):
        x = torch.randn((1, *physics.img_size), dtype=dtype, generator=torch.Generator().manual_seed(0))
        assert physics.adjointness_test(x, num_samples=3) < error
        y = physics.A(x)
        assert y.shape == (1, 1, MASK.count, 200)
        assert y.dtype == dtype
        torch.testing.assert_close(physics.A_A_adjoint(y), physics.A(physics.A_adjoint(y)))
        torch.testing.assert_close(physics.A_adjoint_A(x), physics.A_adjoint(physics.A(x)))


def test_normalised_operator_has_the_norm_one() -> None:
    positions = np.random.default_rng(0).uniform(-1e-3, 1e-3, (9, 2))
    geometry = AcquisitionGeometry(positions, 30, dt=2e-8, sound_speed=1500.0, aperture=2e-3)
    physics = physics_of(geometry, ImageGrid(modes=6, depth=(1e-4, 5e-4)), normalise=True)
    units = torch.eye(int(np.prod(physics.img_size))).reshape(-1, *physics.img_size)
    matrix = physics.A(units).reshape(len(units), -1).numpy()
    assert np.linalg.norm(matrix, 2) == pytest.approx(1, abs=2e-3)


def test_pseudo_inverse_of_closed_form_a_lines_is_the_object(physics) -> None:
    balls = yarn(1, centre=(0.0, 0.0, 1.7e-3), radius=0.9e-3)
    traces = pressure(balls, MASK.positions, samples=200, sampling_interval=2e-8, sound_speed=1500.0)
    image = physics.A_dagger(torch.from_numpy(traces.astype(np.float32))[None, None] / physics.norm)[0, 0]
    volume = steradian.reconstruct(GEOMETRY.acquisition(traces), GRID)
    truth = rasterise(balls, volume).values
    found, direct = (np.corrcoef(truth.ravel(), np.asarray(each).ravel())[0, 1] for each in (image, volume.values))
    assert found == pytest.approx(direct, abs=1e-3)


def test_a_noise_model_of_the_library_is_applied(physics) -> None:
    noisy = physics_of(GEOMETRY, GRID, noise_model=deepinv.physics.GaussianNoise(0.1))
    y = noisy(torch.zeros((1, *noisy.img_size)))
    assert float(y.std()) == pytest.approx(0.1, rel=0.05)


def test_pylops_takes_the_forward_operator() -> None:
    """In a process of its own: pylops compiles for a GPU when it is imported, which Numba's simulator does not know."""
    if importlib.util.find_spec("pylops") is None:
        pytest.skip("pylops: pip install --no-deps -r constraints-operators.txt")
    program = """
import numpy as np, pylops, steradian
positions = np.random.default_rng(0).uniform(-1e-3, 1e-3, (50, 2))
geometry = steradian.AcquisitionGeometry(positions, 100, dt=2e-8, sound_speed=1500.0, aperture=2e-3)
grid, exact = steradian.ImageGrid(modes=12, depth=(1e-4, 1e-3)), steradian.Compute(dtype="float64")
operator = steradian.ForwardOperator(geometry, grid, tolerance=1e-9, compute=exact)
assert pylops.utils.dottest(pylops.aslinearoperator(operator), *operator.shape, rtol=1e-10)
"""
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_ENABLE_CUDASIM"}
    ran = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
