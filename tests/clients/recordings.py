"""The sound of a ball under a grid of sensors, in closed form."""

import numpy as np

SOUND_SPEED, INTERVAL, PITCH, RADIUS, DEPTH = 1500.0, 16e-9, 150e-6, 150e-6, 2e-3


def ball(count=24, samples=200, centre=(0.3e-3, -0.15e-3)):
    """Return A-lines (count², samples) and positions (count², 2) in m; x runs slowest."""
    along = (np.arange(count) - count // 2) * PITCH
    positions = np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1).reshape(-1, 2)
    distance = np.hypot(np.linalg.norm(positions - centre, axis=1), DEPTH)[:, None]
    path = SOUND_SPEED * INTERVAL * np.arange(samples)
    late, early = distance - path, distance + path
    sound = late * np.exp(-(late**2) / 2 / RADIUS**2) + early * np.exp(-(early**2) / 2 / RADIUS**2)
    return (sound / 2 / distance).astype(np.float32), positions
