"""PyTorch operators: products of the library, gradients of all parameters, batches, precisions and errors."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import steradian
from steradian.core.exceptions import InvalidInput
from steradian.imaging import Compute, ImageGrid, InverseFilter, Nufft
from steradian.imaging.film_response import ElasticFilm
from support.small_acquisitions import BEGINS, GRID, PLACES, small_geometry

torch = pytest.importorskip("torch", reason="PyTorch: pip install --no-deps -r constraints-operators.txt")
steradian_torch = pytest.importorskip("steradian.torch")
RNG = np.random.default_rng(1)
CHECK: dict[str, Any] = {"eps": 3e-6, "atol": 1e-6, "rtol": 1e-6, "fast_mode": True}


def variable(values: Any) -> Any:
    return torch.tensor(np.asarray(values, np.float64), requires_grad=True)


def parameters(medium: str) -> list[Any]:
    """Positions in mm, time zero in µs and sound speeds in mm/µs: all of the order of 1."""
    return [variable(1e3 * PLACES), variable(1e6 * BEGINS), variable([1.48, 1.54] if medium == "layers" else 1.5)]


def named(positions: Any, time_zero: Any, sound_speed: Any) -> dict[str, Any]:
    return {"positions": 1e-3 * positions, "time_zero": 1e-6 * time_zero, "sound_speed": 1e3 * sound_speed}


@pytest.mark.parametrize("medium", ["lossless", "attenuating", "layers"])
def test_gradients_of_the_model_are_difference_quotients(medium: str) -> None:
    operator = steradian_torch.ForwardOperator(small_geometry(medium), GRID, tolerance=1e-12)
    image, traces = variable(RNG.random(operator.volume_shape)), variable(RNG.random((2, *operator.trace_shape)))
    assert torch.autograd.gradcheck(operator, (image,), **CHECK)
    assert torch.autograd.gradcheck(operator.adjoint, (traces,), **CHECK)
    given = parameters(medium)
    assert torch.autograd.gradcheck(lambda f, *p: operator(f, **named(*p)), (image, *given), **CHECK)
    assert torch.autograd.gradcheck(lambda g, *p: operator.adjoint(g, **named(*p)), (traces, *given), **CHECK)


def test_gradients_of_the_direct_reconstruction_are_difference_quotients() -> None:
    geometry = replace(small_geometry(), sensitivity=None)
    direct = steradian_torch.DirectReconstruction(geometry, GRID, Nufft(tolerance=1e-12))
    traces, weights = variable(RNG.random(direct.trace_shape)), variable(np.linspace(1, 2, 5))
    image = variable(RNG.random(direct.volume_shape))
    given = parameters("lossless")
    assert torch.autograd.gradcheck(
        lambda g, w, *p: direct(g, weights=1e-7 * w, **named(*p)), (traces, weights, *given), **CHECK
    )
    assert torch.autograd.gradcheck(lambda f, *p: direct.adjoint(f, **named(*p)), (image, *given), **CHECK)


def test_products_are_those_of_the_library_for_each_of_a_batch() -> None:
    for dtype, error in (("float32", 1e-5), ("float64", 1e-12)):
        library = steradian.ForwardOperator(small_geometry(), GRID, compute=Compute(dtype=dtype))
        operator = steradian_torch.ForwardOperator(small_geometry(), GRID)
        images = RNG.random((2, 3, *operator.volume_shape)).astype(dtype)
        found = operator(torch.from_numpy(images))
        assert found.shape == (2, 3, *operator.trace_shape)
        assert found.numpy().dtype == dtype
        expected = library.forward(images[1, 2])
        assert np.abs(found[1, 2].numpy() - expected).max() <= error * np.abs(expected).max()
        # with its own parameters it is the same, to the tolerance
        moved = operator(torch.from_numpy(images), positions=torch.from_numpy(PLACES))
        assert (moved - found).norm() <= 2e-4 * found.norm()


def test_direct_reconstruction_is_that_of_the_library() -> None:
    grid = ImageGrid(modes=(5, 7))
    acquisition = small_geometry().acquisition(RNG.random((5, 16)))
    expected = steradian.reconstruct(acquisition, grid).values
    direct = steradian_torch.DirectReconstruction(small_geometry(), grid)
    found = direct(torch.from_numpy(np.asarray(acquisition.traces, np.float32))).numpy()
    assert np.linalg.norm(found - expected) <= 2e-4 * np.linalg.norm(expected)


def test_a_tensor_in_memory_is_not_copied() -> None:
    operator = steradian_torch.ForwardOperator(small_geometry(), GRID)
    found = operator(torch.zeros(operator.volume_shape))
    assert not found.numpy().flags.owndata  # a view of what was computed


def test_second_derivatives_by_the_image_exist_and_by_parameters_are_refused() -> None:
    operator = steradian_torch.ForwardOperator(small_geometry(), GRID, tolerance=1e-12)
    image, positions = variable(RNG.random(operator.volume_shape)), variable(PLACES)
    assert torch.autograd.gradgradcheck(lambda f: operator(f).square(), (image,), fast_mode=True)
    (gradient,) = torch.autograd.grad(operator(image, positions=positions).square().sum(), positions, create_graph=True)
    with pytest.raises((NotImplementedError, RuntimeError), match=r"second derivatives|once_differentiable"):
        gradient.sum().backward()


def test_parameters_that_changed_since_the_product_are_refused() -> None:
    operator = steradian_torch.ForwardOperator(small_geometry(), GRID)
    positions = variable(PLACES)
    loss = operator(torch.ones(operator.volume_shape), positions=positions).square().sum()
    with torch.no_grad():
        positions.mul_(0.5)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        loss.backward()


def test_gradient_by_a_speed_has_the_shape_of_the_speed() -> None:
    for medium, speeds in (("attenuating", [1500.0]), ("lossless", [1500.0]), ("layers", [1480.0, 1540.0])):
        operator, speed = steradian_torch.ForwardOperator(small_geometry(medium), GRID), variable(speeds)
        operator(torch.ones(operator.volume_shape), sound_speed=speed).square().sum().backward()
        assert speed.grad.shape == speed.shape
        assert (speed.grad != 0).all()


def test_arrays_of_the_geometry_may_be_changed_afterwards() -> None:
    places, sensitivity = PLACES.copy(), np.linspace(1, 2, 5)
    geometry = replace(small_geometry(), sensors=places, sensitivity=sensitivity)
    operator, image = steradian_torch.ForwardOperator(geometry, GRID), torch.ones(1).expand(5, 4, 7)
    before = operator(image)
    places *= 0.5
    sensitivity *= 0.5
    torch.testing.assert_close(operator(image.double()).float(), before, rtol=1e-3, atol=1e-6)
    torch.testing.assert_close(operator(image, positions=torch.from_numpy(PLACES)), before, rtol=1e-3, atol=1e-5)


def test_wrong_input_is_refused() -> None:
    operator = steradian_torch.ForwardOperator(small_geometry(), GRID)
    with pytest.raises(InvalidInput, match="image"):
        operator(torch.zeros(3, 3, 3))
    with pytest.raises(InvalidInput, match="image"):
        operator(np.zeros(operator.volume_shape))
    with pytest.raises(InvalidInput, match="traces"):
        operator.adjoint(torch.zeros(operator.trace_shape, dtype=torch.int32))
    with pytest.raises(InvalidInput, match="positions"):
        operator(torch.zeros(operator.volume_shape), positions=torch.zeros(4, 2))
    with pytest.raises(InvalidInput, match="sound_speed"):
        steradian_torch.ForwardOperator(small_geometry("layers"), GRID)(
            torch.zeros(operator.volume_shape), sound_speed=1510.0
        )
    for name, value in (("positions", PLACES), ("time_zero", torch.zeros(2)), ("sound_speed", "fast")):
        with pytest.raises(InvalidInput, match=name):
            operator(torch.zeros(operator.volume_shape), **{name: value})
    with pytest.raises(InvalidInput, match="batch"):
        operator(torch.zeros(0, *operator.volume_shape))
    with pytest.raises(InvalidInput, match="medium"):
        steradian_torch.DirectReconstruction(small_geometry("attenuating"), GRID)
    with pytest.raises(InvalidInput, match="correction"):
        steradian_torch.DirectReconstruction(small_geometry(), GRID, Nufft(correction=InverseFilter(ElasticFilm())))
    with pytest.raises(InvalidInput, match="weights"):
        steradian_torch.DirectReconstruction(small_geometry(), GRID)(torch.zeros(5, 16), weights=torch.zeros(4))


def test_positions_move_to_where_the_sound_was_measured() -> None:
    """Sensors 20 µm beside their places are found again from A-lines of a known object."""
    geometry = replace(small_geometry(), samples=60, sensitivity=None, t0=0.0)
    grid = ImageGrid(modes=21, depth=(1e-4, 8e-4))
    operator = steradian_torch.ForwardOperator(geometry, grid, tolerance=1e-6, compute=Compute(threads=1))
    z, y, x = (np.linspace(-1, 1, n) for n in operator.volume_shape[::-1])
    image = np.zeros(operator.volume_shape)
    for centre in ((-0.4, 0.2, 0.0), (0.3, -0.3, 0.4), (0.1, 0.5, -0.4)):
        distance = sum(
            np.square((axis - c).reshape(shape))
            for axis, c, shape in zip((x, y, z), centre, ((-1, 1, 1), (1, -1, 1), (1, 1, -1)), strict=True)
        )
        image += np.exp(-distance / 0.03)
    image = torch.from_numpy(image)
    with torch.no_grad():
        measured = operator(image, positions=torch.from_numpy(PLACES))
    offset = variable(20.0 * np.sign(PLACES))  # in µm, towards the rim
    solver = torch.optim.LBFGS([offset], max_iter=30, line_search_fn="strong_wolfe", tolerance_grad=1e-12)

    def misfit() -> Any:
        solver.zero_grad()
        traces = operator(image, positions=torch.from_numpy(PLACES) + 1e-6 * offset)
        loss = (traces - measured).square().sum() / measured.square().sum()
        loss.backward()
        return loss

    solver.step(misfit)
    assert offset.abs().max() < 0.2
