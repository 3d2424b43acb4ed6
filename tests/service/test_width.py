"""Full width at half maximum against closed forms, and its correction against vessels of known diameter."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from fabry_perot.simulator.phantoms import Balls
from steradian import InvalidInput, quality
from steradian.imaging import Volume, VoxelAxes
from steradian.masks import equi_steradian_mask
from steradian.phantoms.forward import pressure
from steradian.quality.profiles import profile
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.run import reconstruct_in_memory
from steradian.reconstructions.studies.orientation import direction_at
from steradian.reconstructions.studies.width import measure_width
from steradian.scans.recording import Recording

GAUSSIAN = np.sqrt(8 * np.log(2))
SPEED, INTERVAL, SAMPLES, DEPTH = 1500.0, 8e-9, 540, 2.5e-3


@pytest.mark.parametrize("base", [0.0, 0.4, -0.2])
def test_width_of_gaussian_on_any_base_is_its_own(base: float) -> None:
    x = np.linspace(-2, 2, 401)
    found = quality.width(x, base + np.exp(-(x**2) / (2 * 0.2**2)))
    assert found.fwhm == pytest.approx(GAUSSIAN * 0.2, rel=1e-3)
    assert found.base == pytest.approx(base, abs=1e-3)
    assert quality.direct_fwhm(x, base + np.exp(-(x**2) / (2 * 0.2**2))) == found.fwhm


def test_repeatability_of_noisy_gaussian_is_scatter_of_widths() -> None:
    random, x = np.random.default_rng(5), np.arange(-2, 2, 0.05)
    noisy = np.exp(-(x**2) / (2 * 0.25**2)) + random.normal(0, 0.03, (400, x.size))
    found = [quality.width(x, values) for values in noisy]
    scatter = np.std([each.fwhm for each in found])
    assert 0.6 < np.median([each.repeatability or 0 for each in found]) / scatter < 1.5


def test_width_of_monotonic_profile_is_refused() -> None:
    with pytest.raises(InvalidInput, match="half"):
        quality.width(np.arange(5.0), np.arange(5.0))


def test_direction_of_oblique_gaussian_tube_is_its_axis_and_of_ball_none() -> None:
    line = 5e-5 * (np.arange(41) - 20)
    places = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1)
    way = np.array([0.6, 0.64, 0.48])
    beside = (places**2).sum(axis=-1) - (places @ way) ** 2
    axes = VoxelAxes(line, line, line)
    tube = Volume(np.exp(-beside / (2 * 1e-4**2)), axes, (5e-5,) * 3)
    found = direction_at(tube, (0, 0, 0), GAUSSIAN * 1e-4)
    assert found is not None
    assert abs(found @ way) > 0.995
    ball = Volume(np.exp(-(places**2).sum(axis=-1) / (2 * 1e-4**2)), axes, (5e-5,) * 3)
    assert direction_at(ball, (0, 0, 0), GAUSSIAN * 1e-4) is None
    across = quality.width(*profile(ball, (-8e-4, -8e-4, 0), (8e-4, 8e-4, 0)))
    assert across.fwhm == pytest.approx(GAUSSIAN * 1e-4, rel=0.03)


def vessel(diameter: float) -> Balls:
    """A uniform cylinder along y, as a dense sum of balls with s of 6 µm or a 24th of its diameter."""
    s = max(diameter / 24, 6e-6)
    pitch = 1.5 * s
    count = int(np.ceil(diameter / 2 / pitch))
    grid, fine = np.arange(-count, count + 1) * pitch, ((np.arange(8) + 0.5) / 8 - 0.5) * pitch
    share = np.array(
        [[((a + fine[:, None]) ** 2 + (b + fine) ** 2 <= (diameter / 2) ** 2).mean() for b in grid] for a in grid]
    )
    a, b = (grid[index] for index in np.nonzero(share))
    along = np.arange(-1.9e-3, 1.9e-3, pitch)
    centres = np.stack([np.repeat(a, len(along)), np.tile(along, len(a)), DEPTH + np.repeat(b, len(along))], axis=1)
    amplitudes = np.repeat(share[share > 0], len(along)) * (1.5 / np.sqrt(2 * np.pi)) ** 3
    return Balls(centres, np.full(len(centres), s), amplitudes)


def gaussian_vessel(diameter: float) -> Balls:
    """A cylinder along y with a Gaussian profile of that full width at half maximum."""
    s = diameter / GAUSSIAN
    along = np.arange(-1.9e-3, 1.9e-3, 1.2 * s)
    centres = np.column_stack([np.zeros_like(along), along, np.full_like(along, DEPTH)])
    return Balls(centres, np.full(len(along), s), np.full(len(along), 1.2 / np.sqrt(2 * np.pi)))


@lru_cache
def recording(edge: str, diameter: float) -> Recording:
    """Such a vessel seen by 1,600 equi-steradian points, with noise of 30 dB."""
    balls = vessel(diameter) if edge == "uniform" else gaussian_vessel(diameter)
    mask = equi_steradian_mask(aperture=8e-3, depth=DEPTH, count=1600)
    places = np.asarray(mask.positions)
    traces = pressure(balls, places, samples=SAMPLES, sampling_interval=INTERVAL, sound_speed=SPEED)
    noise = np.random.default_rng(1).standard_normal(traces.shape).astype(np.float32)
    traces += noise * np.abs(traces).max() * np.float32(10**-1.5)
    weights = np.asarray(mask.weights)
    return Recording(traces, 1.0, places, weights, INTERVAL, SPEED, mask.aperture, 0.0, None, None, len(places), {})


VESSELS = [(edge, diameter) for edge in ("uniform", "Gaussian") for diameter in (100e-6, 150e-6, 210e-6, 280e-6)]
NARROWEST, FASTEST = {("uniform", 100e-6)}, {("Gaussian", 280e-6)}
"""Vessels that are not nightly: of the direct method, and of the iterative one, which images it in the least time."""


@pytest.mark.parametrize(
    ("method", "edge", "diameter"),
    [
        pytest.param(method, *vessel, marks=pytest.mark.long if vessel in vessels else pytest.mark.nightly)
        for method, vessels in (("nedner", NARROWEST), ("iterative", FASTEST))
        for vessel in VESSELS
    ],
)
def test_corrected_width_of_vessel_is_its_diameter(method: str, diameter: float, edge: str) -> None:
    scan = recording(edge, diameter)
    how = ReconstructionParameters.create(method=method, modes=133, depth_range=(1.5e-3, 3.5e-3))
    image = reconstruct_in_memory(scan, how)
    found = measure_width(image, scan, (-1.2e-3, 0, DEPTH), (1.2e-3, 0, DEPTH), parameters=how)
    assert found.shape == f"{edge} cylinder"
    assert found.point_spread == pytest.approx(68e-6, rel=0.1), "hardly more than a voxel"
    assert found.corrected == pytest.approx(diameter, rel=0.08)
    if method == "nedner":
        assert found.fwhm > 1.2 * diameter, "uncorrected it is far too wide"


@pytest.mark.long
def test_width_near_point_spread_gives_only_upper_bound() -> None:
    scan = recording("Gaussian", 20e-6)
    how = ReconstructionParameters.create(modes=133, depth_range=(1.5e-3, 3.5e-3))
    image = reconstruct_in_memory(scan, how)
    found = measure_width(image, scan, (-1.2e-3, 0, DEPTH), (1.2e-3, 0, DEPTH), parameters=how)
    assert found.corrected is None
    assert found.at_most is not None
    assert 20e-6 < found.at_most < 100e-6
    assert "at most" in found.reason
