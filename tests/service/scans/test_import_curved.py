"""Curved arrays, which are no planar apertures though all their sensors may lie on a plane."""

import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
import foreign

from steradian.core.exceptions import InvalidInput
from steradian.scans.importing import import_scan


def arc(count, degrees, radius=10e-3, *, noise=0.0):
    """(M, 3) places on an arc in the plane of x and z, in the middle of which the object is."""
    angle = np.radians(np.linspace(-degrees / 2, degrees / 2, count))
    places = radius * np.column_stack([np.sin(angle), np.zeros(count), 1 - np.cos(angle)])
    return places + noise * np.random.default_rng(1).normal(size=places.shape) * [1, 0, 1]


def archive(folder, points):
    np.savez(folder / "a.npz", traces=np.ones((len(points), 64)), positions=points, dt=2e-8, c=1500.0)
    return folder / "a.npz"


@pytest.mark.parametrize("degrees", [40, 90, 174, 270])
@pytest.mark.parametrize("count", [12, 40, 256])
def test_sensors_on_an_arc_are_refused(tmp_path, count, degrees):
    with pytest.raises(InvalidInput, match="sensors on a curve in the plane of z and x"):
        import_scan(archive(tmp_path, arc(count, degrees)), tmp_path / "scan.h5")


def test_ipasc_detectors_on_an_arc_are_refused(tmp_path):
    source = turned(tmp_path, arc(96, 120), directions=None)
    with pytest.raises(InvalidInput, match="on a curve"):
        import_scan(source, tmp_path / "scan.h5")


def test_ipasc_detectors_on_a_ring_that_look_inwards_are_refused(tmp_path):
    ring = arc(97, 360)[:-1]
    source = turned(tmp_path, ring, directions=(ring.mean(axis=0) - ring) / 10e-3)
    with pytest.raises(InvalidInput, match="look along it"):
        import_scan(source, tmp_path / "scan.h5")


def turned(folder, points, *, directions):
    """Place an IPASC file's detectors elsewhere."""
    source, _ = foreign.ipasc_by_pacfish(folder)
    with h5py.File(source, "r+") as file:
        detectors = file["meta_data_device/detectors"]
        for number, name in enumerate(sorted(detectors)):
            detectors[name]["detector_position"][...] = points[number]
            if directions is not None:
                detectors[name].pop("detector_orientation", None)
                detectors[name]["detector_orientation"] = directions[number]
    return source


def ring():
    return arc(41, 360)[:-1, [0, 2, 1]]


def corner():
    steps = np.arange(20) * 1e-4
    return np.concatenate([np.column_stack([steps, 0 * steps]), np.column_stack([0 * steps, steps])[1:]])


@pytest.mark.parametrize(
    "points",
    [
        ring(),
        corner(),
        np.random.default_rng(2).uniform(-1e-3, 1e-3, (12, 2)),
        foreign.grid(),
        np.column_stack([np.arange(30) * 1e-4, np.zeros(30)]),
        np.array([[0, 0], [0, 1], [1, 0], [1, 1]]) * 1e-3,
    ],
    ids=["ring", "corner", "scattered", "grid", "line", "square"],
)
def test_sensors_of_a_planar_aperture_are_taken(tmp_path, points):
    assert import_scan(archive(tmp_path, points), tmp_path / "scan.h5").points == len(points)
