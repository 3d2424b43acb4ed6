"""Sensors of different sensitivity: weights of direct methods, and rows of the model of the iterative one."""

import numpy as np
import pytest

from steradian import (
    Acquisition,
    ForwardOperator,
    ImageGrid,
    InvalidInput,
    Iterative,
    Layer,
    Medium,
    Nufft,
    ReconstructionPlan,
    equi_steradian_mask,
    reconstruct,
)
from steradian.imaging import ATTENUATIONS, AcquisitionGeometry, Compute, Gridded, SensingSpot
from steradian.imaging.incremental import IncrementalReconstruction
from steradian.phantoms import Balls, pressure

MASK = equi_steradian_mask(6e-3, 2e-3, 400)
TIMING = {"dt": 16e-9, "sound_speed": 1500.0}
SAMPLES = 300
GRID = ImageGrid(48, depth=(1e-3, 3.4e-3))
SIZE = 90e-6
CENTRES = np.array([(0.4e-3, -0.3e-3, 1.5e-3), (-1.0e-3, 0.6e-3, 2.2e-3), (0.9e-3, 1.1e-3, 2.9e-3)])
BALLS = Balls(CENTRES, np.full(3, SIZE), np.ones(3))
IDEAL = pressure(BALLS, MASK.positions, samples=SAMPLES, sampling_interval=16e-9, sound_speed=1500.0)
SENSITIVITY = np.where(np.random.default_rng(0).random(MASK.count) < 0.4, 0.3, 1.0)


def image(traces, sensitivity, method=None):
    return reconstruct(Acquisition(traces, MASK, sensitivity=sensitivity, **TIMING), GRID, method or Nufft())


def noise(deviation=1.0, seed=0):
    return deviation * np.random.default_rng(seed).standard_normal(IDEAL.shape).astype(np.float32)


def test_direct_image_keeps_amplitudes_and_has_less_noise_than_that_of_divided_alines():
    whole = image(IDEAL, None)
    x, y, z = whole.axes.x, whole.axes.y, whole.axes.z
    ball = tuple(
        np.argmin(abs(axis[:, None] - places), axis=0) for axis, places in zip((x, y, z), CENTRES.T, strict=True)
    )
    weighted = image(IDEAL * SENSITIVITY[:, None].astype(np.float32), SENSITIVITY)
    np.testing.assert_allclose(weighted.values[ball], whole.values[ball], rtol=0.05)
    divided_noise = image(noise() / SENSITIVITY[:, None], None).values.std()
    assert image(noise(), SENSITIVITY).values.std() < 0.65 * divided_noise


def test_equal_sensitivities_change_the_image_by_their_factor_alone():
    np.testing.assert_allclose(
        image(IDEAL, np.full(MASK.count, 0.5)).values, 2 * image(IDEAL, None).values, rtol=1e-5, atol=1e-6
    )


@pytest.mark.long
@pytest.mark.parametrize("regularisation", ["thresholding", "total-variation"])
def test_iterative_image_is_nearer_to_the_object_than_that_of_divided_alines(regularisation):
    method = Iterative(regularisation=regularisation)
    grid = image(IDEAL, None).axes
    places = (grid.x[:, None, None, None], grid.y[None, :, None, None], grid.z[None, None, :, None])
    squares = sum((axis - centre) ** 2 for axis, centre in zip(places, CENTRES.T, strict=True))
    true = np.exp(-squares / (2 * SIZE**2)).sum(axis=-1)
    recorded = IDEAL * SENSITIVITY[:, None].astype(np.float32) + noise(0.2 * np.abs(IDEAL).max())
    fitted, divided = (
        np.linalg.norm(values.values - true) / np.linalg.norm(true)
        for values in (
            image(recorded, SENSITIVITY, method),
            image(recorded / SENSITIVITY[:, None], None, method),
        )
    )
    assert fitted < 0.9 * divided


def operators(sensitivity):
    medium = Medium([Layer(1480.0, 1e-3, attenuation=ATTENUATIONS["water"]), Layer(1580.0)])
    geometry = AcquisitionGeometry(
        MASK.positions[:60], 200, dt=16e-9, medium=medium, aperture=6e-3, sensitivity=sensitivity
    )
    return ForwardOperator(
        geometry, ImageGrid(16, depth=(0.6e-3, 2.4e-3)), response=SensingSpot(100e-6), compute=Compute(dtype="float64")
    )


def test_model_has_a_factor_for_each_sensor_and_its_exact_transpose():
    sensitivity = SENSITIVITY[:60]
    model, plain = operators(sensitivity), operators(None)
    random = np.random.default_rng(1)
    volume, traces = random.standard_normal(model.volume_shape), random.standard_normal(model.trace_shape)
    heard = model.forward(volume)
    np.testing.assert_allclose(heard, sensitivity[:, None] * plain.forward(volume), rtol=1e-12)
    ends = np.vdot(heard, traces), np.vdot(volume, model.backward(traces))
    assert abs(ends[0] - ends[1]) <= 1e-12 * np.linalg.norm(heard) * np.linalg.norm(traces)


@pytest.mark.parametrize(
    ("sensitivity", "told"),
    [
        (np.ones(7), rf"sensitivity.*shape \(7,\).*shape \({MASK.count},\)"),
        (np.where(np.arange(MASK.count) == 5, 0.0, 1.0), r"sensitivity.*0 at 5.*0\.001 to 1000"),
        (np.where(np.arange(MASK.count) == 5, np.nan, 1.0), "sensitivity"),
        (np.where(np.arange(MASK.count) == 9, -1.0, 1.0), r"sensitivity.*-1 at 9"),
    ],
)
def test_wrong_sensitivities_are_refused_with_field_value_and_range(sensitivity, told):
    for method in (Nufft(), Iterative()):
        with pytest.raises(InvalidInput, match=told):
            image(IDEAL, sensitivity, method)


def test_methods_that_cannot_weight_sensors_refuse_sensitivities():
    with pytest.raises(InvalidInput, match=r"sensitivity.*divide the A-lines"):
        image(IDEAL, SENSITIVITY, Gridded())
    geometry = AcquisitionGeometry(MASK, SAMPLES, sensitivity=SENSITIVITY, **TIMING)
    with pytest.raises(InvalidInput, match=r"sensitivity.*divide the A-lines"):
        IncrementalReconstruction(ReconstructionPlan(geometry, GRID))
