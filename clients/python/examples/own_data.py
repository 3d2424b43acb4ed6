"""Own data to a volume with axes, direct and iterative: the sound of a ball, recorded by a square of sensors."""

import numpy as np

from steradian_client import Client

pitch, interval, speed, size, depth = 100e-6, 16e-9, 1500.0, 100e-6, 3e-3  # m, s, m/s, m, m
along = (np.arange(48) - 24) * pitch
positions = np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1).reshape(-1, 2)
distance = np.hypot(np.linalg.norm(positions, axis=1), depth)[:, None]
path = speed * interval * np.arange(400)
late, early = distance - path, distance + path
traces = sum(way * np.exp(-(way**2) / 2 / size**2) for way in (late, early)) / (2 * distance)

with Client() as service:  # STERADIAN_URL and STERADIAN_KEY say where
    scan = service.imports.import_arrays(
        traces, positions, sampling_interval=interval, sound_speed=speed, progress=print
    )
    for method in ("nedner", "iterative"):
        job = service.reconstructions.create(scan.id, method=method, modes=48)
        service.reconstructions.wait(job, progress=print)
        volume = service.reconstructions.volume(job.id)  # values[x, y, z], places along x, y and z in metres
        at = np.unravel_index(volume.values.argmax(), volume.values.shape)
        places = [1e3 * axis[i] for axis, i in zip((volume.x, volume.y, volume.z), at, strict=True)]
        print(f"{method}: {volume.values.max():.2f} at {places[0]:.3f}, {places[1]:.3f}, {places[2]:.3f} mm")
