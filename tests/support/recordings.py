"""The sound of a ball under a grid of sensors, in closed form."""

import json

import numpy as np

SOUND_SPEED, INTERVAL, PITCH, RADIUS, DEPTH = 1500.0, 16e-9, 150e-6, 150e-6, 2e-3


def ball(count=24, samples=200, centre=(0.3e-3, -0.15e-3), depth=DEPTH):
    """Return A-lines (count², samples) and positions (count², 2) in m; x runs slowest."""
    along = (np.arange(count) - count // 2) * PITCH
    positions = np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1).reshape(-1, 2)
    distance = np.hypot(np.linalg.norm(positions - centre, axis=1), depth)[:, None]
    path = SOUND_SPEED * INTERVAL * np.arange(samples)
    late, early = distance - path, distance + path
    sound = late * np.exp(-(late**2) / 2 / RADIUS**2) + early * np.exp(-(early**2) / 2 / RADIUS**2)
    return (sound / 2 / distance).astype(np.float32), positions


def save(path):
    """Write the recording as somebody's own file."""
    traces, positions = ball()
    np.savez(path, traces=traces, positions=positions, sampling_interval=INTERVAL, c=SOUND_SPEED)


def expect_the_ball(folder):
    """Check what a walk left: a direct and an iterative volume, each with its axes and the ball in its place."""
    for method in ("nedner", "iterative"):
        report = json.loads((folder / f"{method}.json").read_text())["report"]
        volume = np.load(folder / f"{method}.npy")
        brightest = np.unravel_index(volume.argmax(), volume.shape)
        place = np.array(report["origin_m"]) + np.array(report["spacing_m"]) * brightest
        assert volume.shape == tuple(report["shape"])
        assert np.abs(place - (0.3e-3, -0.15e-3, DEPTH)).max() <= 0.6 * max(report["spacing_m"])
        assert (folder / f"{method}.png").read_bytes()[1:4] == b"PNG"
