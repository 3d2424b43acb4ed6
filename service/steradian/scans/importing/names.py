"""Names by which variables of MATLAB files and arrays of .npz archives are understood, the first that is there.

``docs/formats.md`` lists them.
"""

from __future__ import annotations

TRACES = ("sensor_data", "traces")
INTERVAL = ("dt", "sampling_interval")
SPEED = ("sound_speed", "c", "c0", "medium_sound_speed", "c_ref")
TIME_ZERO = ("time_zero", "t0")
POSITIONS = ("positions", "sensor_positions")
MASK = ("mask", "sensor_mask")
WEIGHTS = ("weights",)
APERTURE = ("aperture",)
DEPTH = ("depth",)
STEPS = ("dx", "dy", "dz")
"""Pitches along the axes of a mask or of an array of sensors."""
LATERAL_STEPS = (("dy", "dx"), ("dz", "dy", "dx"))
"""Pitches along our x and y of k-Wave's ``p`` (time, y, z); its ``dx`` is the step in depth where there are others."""

NUMBERS = (*INTERVAL, *SPEED, *TIME_ZERO, *APERTURE, *DEPTH, *STEPS)
GEOMETRY = (*POSITIONS, *MASK, *WEIGHTS)
KGRID = "kgrid/dx"
"""A structure of k-Wave's that has the pitch too."""
