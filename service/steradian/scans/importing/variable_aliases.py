"""Accepted variable names (aliases) in MATLAB and .npz files.

``docs/formats.md`` lists them.
"""

from __future__ import annotations

TRACES = ("sensor_data", "traces")
INTERVAL = ("dt", "sampling_interval", "kgrid/dt")
RATE = ("fs", "sampling_rate", "sampling_frequency")
"""Samples a second, where no time between samples is there."""
SPEED = ("sound_speed", "c", "c0", "medium_sound_speed", "c_ref", "medium/sound_speed")
TIME_ZERO = ("time_zero", "t0")
POSITIONS = ("positions", "sensor_positions")
MASK = ("mask", "sensor_mask", "sensor/mask")
WEIGHTS = ("weights",)
APERTURE = ("aperture",)
DEPTH = ("depth",)
ENERGIES = ("energies", "energy", "pulse_energies", "pulse_energy")
STEPS = ("dx", "dy", "dz")
"""Pitches along the axes of a mask or of an array of sensors."""
KGRID = tuple(f"kgrid/{name}" for name in STEPS)
"""The same as fields of k-Wave's structure."""
LATERAL_STEPS = (("dy", "dx"), ("dz", "dy", "dx"))
"""Pitches along our x and y of k-Wave's ``p`` (time, y, z); its ``dx`` is the step in depth where there are others."""

NUMBERS = (*INTERVAL, *RATE, *SPEED, *TIME_ZERO, *APERTURE, *DEPTH, *STEPS, *KGRID)
GEOMETRY = (*POSITIONS, *MASK, *WEIGHTS, *ENERGIES)
