"""Lattice detection of a mask: number of voxels an axis suggested by the sensors' lattice pitch."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.imaging.geometry.sensor_areas import detect_sensor_grid

USUAL = 60e-6, 0.5e-3
"""Pitches in m that suggest no voxel of their own: lattices of Fabry–Pérot scanners resolve more than their pitch, as
their A-lines tell of steeper waves; coarser ones show a comb at finer voxels, and finer ones resolve their pitch."""
FILLED = 0.6
"""Share of a lattice's places that must have a sensor: dead channels and lines left out are gaps."""
WHOLE = 1e-3
"""How far an aperture may be from a whole number of pitches, in pitches."""


def lattice_modes(positions: NDArray[np.float64], aperture: float) -> int | None:
    """Return the number of voxels an axis at the sensors' lattice pitch; ``None`` without a lattice.

    Parameters
    ----------
    positions
        (M, 2) metres, or (M, 1) on a line.
    aperture
        Side in metres.

    Returns
    -------
    int or None
        Of a lattice with two pitches by the smaller. At most two fifths of a lattice's places may be gaps. ``None`` for
        a usual pitch (``USUAL``), and where the aperture is no whole number of pitches of at least two.
    """
    lattice = detect_sensor_grid(positions, filled=FILLED)
    if lattice is None:
        return None
    pitch = float(lattice.pitch.min())
    if USUAL[0] <= pitch * (1 + WHOLE) and pitch <= USUAL[1]:
        return None
    exact = aperture / pitch
    modes = round(exact)
    return modes if modes >= 2 and abs(exact - modes) < WHOLE * modes else None


def imported_modes(positions: NDArray[np.float64], aperture: float, arrangement: Mapping[str, Any]) -> int | None:
    """Return the number of voxels an axis of an imported mask's lattice; ``None`` for other masks.

    A scan of a mask of our own is imaged at voxels of one size whatever its arrangement, so that arrangements can be
    compared.
    """
    return lattice_modes(positions, aperture) if "source" in arrangement else None
