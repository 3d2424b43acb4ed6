"""Reconstructions of data that another project simulated (see tests/data/README.md)."""

from pathlib import Path

import numpy as np
import pytest

from steradian.quality import correlation
from support.flat import flat_reconstruct

DATA = Path(__file__).parents[2] / "data"


class Tree:
    """The paper's 2-D experiment: 32 of 1,024 sensors and the truth."""

    def __init__(self):
        with np.load(DATA / "tree_kwave_slice.npz") as file:
            self.data = dict(file)
        self.dx, self.dt, self.speed = (float(self.data[name]) for name in ("dx", "dt", "c"))
        rows, columns = np.mgrid[:256, :1024]
        self.region = (rows - 128) ** 2 + (columns - 512) ** 2 < 100**2

    def correlation(self, choice, method, weights=None):
        """Pearson correlation with the truth in a disc around the point of interest."""
        columns = self.data[choice]
        traces = self.data["traces"][np.searchsorted(self.data["sensors"], columns)]
        volume = flat_reconstruct(
            traces,
            (columns - 512) * self.dx,
            sampling_interval=self.dt,
            sound_speed=self.speed,
            aperture=1024 * self.dx,
            modes=1024,
            weights=weights,
            method=method,
        )
        depths = np.arange(256) * self.dx
        image = np.array([np.interp(depths, volume.axes.z, line) for line in volume.values]).T
        return correlation(image, self.data["p0"], self.region)

    def weights(self):
        """h ∝ r² (paper, section 4.2)."""
        squares = (self.data["equiangular"] - 512.0) ** 2 + 128.0**2
        return squares / squares.sum() * 1024 * self.dx


@pytest.fixture(scope="module")
def tree():
    return Tree()


def test_nedner_on_equiangular_sensors_beats_filling_the_gaps(tree):
    """32 equiangular sensors: NEDNER is clearly closer to the truth than linear filling, then NER."""
    ours = tree.correlation("equiangular", "nedner", tree.weights())
    filled = tree.correlation("equiangular", "interpolated")
    assert ours > 0.76
    assert (ours - filled) / (1 - filled) > 0.2


@pytest.mark.parametrize("method", ["linear", "nearest", "ner"])
def test_nedner_on_equiangular_sensors_beats_a_coarse_grid(tree, method):
    """As many sensors at equal distance, reconstructed by any method, are clearly farther from the truth."""
    ours = tree.correlation("equiangular", "nedner", tree.weights())
    grid = tree.correlation("equispaced", method)
    assert (ours - grid) / (1 - grid) > 0.15


@pytest.mark.parametrize(
    ("method", "least"),
    [("nedner", 0.965), ("ner", 0.965), ("linear", 0.93), ("nearest", 0.93), ("interpolated", 0.965)],
)
def test_every_method_reconstructs_the_yarn(method, least):
    """The z-MIP of a 3-D yarn from a grid of sensors resembles the truth's, and κ interpolation costs a little."""
    with np.load(DATA / "yarn_kwave_slice.npz") as file:
        pressure, pitch = file["p"], float(file["dx"])
        line = (np.arange(64) - 32) * pitch
        x, y = np.meshgrid(line, line, indexing="ij")
        volume = flat_reconstruct(
            pressure.reshape(len(pressure), -1).T,
            np.column_stack([x.ravel(), y.ravel()]),
            sampling_interval=float(file["dt"]),
            sound_speed=float(file["c"]),
            aperture=64 * pitch,
            modes=64,
            method=method,
        )
        assert correlation(volume.mip("z"), file["p0_mip"]) > least
