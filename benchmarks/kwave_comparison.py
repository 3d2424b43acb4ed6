"""Our reconstruction beside k-wave-python's ``kspacePlaneRecon`` on the same gridded data, in one process.

k-wave-python is no dependency: install it beside Steradian (``pip install . k-wave-python``) and run

    python benchmarks/kwave_comparison.py [SIDE [SAMPLES]]

It prints the time of each (median of 3 runs after a first one, plan excluded), the ratio to scipy's float32
rfftn + irfftn of the same array, peak memory beyond the data, and how alike the two volumes are.
"""

import sys
import time
import tracemalloc
import urllib.request

import numpy as np
from scipy import fft

from steradian import AcquisitionGeometry, Compute, ImageGrid, ReconstructionPlan
from steradian.quality import correlation

PITCH, INTERVAL, SPEED = 60e-6, 8e-9, 1500.0


def offline(*_args: object) -> None:
    """Stand in for the download of solver binaries at import, which this comparison does not use."""
    raise TimeoutError


def main(side: int = 128, samples: int = 512) -> None:
    """Compare on a grid of ``side`` × ``side`` sensors."""
    urllib.request.urlretrieve = offline
    from kwave.kspacePlaneRecon import kspacePlaneRecon

    line = (np.arange(side) - side // 2) * PITCH
    x, y = np.meshgrid(line, line, indexing="ij")
    positions = np.column_stack([x.ravel(), y.ravel()])
    traces = _ball(positions, samples)
    as_kwave = np.ascontiguousarray(traces.reshape(side, side, samples).transpose(2, 0, 1)).astype(np.float64)
    geometry = AcquisitionGeometry(positions, samples, dt=INTERVAL, sound_speed=SPEED, aperture=side * PITCH)
    plan = ReconstructionPlan(geometry, ImageGrid(side), compute=Compute(device="cpu"))
    array = np.zeros((side, side, samples), np.float32)
    bare = _measure(lambda: fft.irfftn(fft.rfftn(array, workers=-1), array.shape, workers=-1))
    ours = _measure(lambda: plan.run(traces))
    theirs = _measure(
        lambda: kspacePlaneRecon(as_kwave, PITCH, PITCH, INTERVAL, SPEED, data_order="tyz", interp="linear")
    )
    print(f"{side} x {side} sensors, {samples} samples")
    for name, (seconds, memory, _) in {"rfftn + irfftn": bare, "steradian": ours, "k-wave-python": theirs}.items():
        print(f"{name:15} {seconds:8.3f} s {seconds / bare[0]:8.2f} x bare {memory / array.size:8.1f} B a sample")
    print(f"k-wave-python takes {theirs[0] / ours[0]:.0f} x the time and {theirs[1] / ours[1]:.0f} x the memory")
    image = np.asarray(theirs[2]).transpose(1, 2, 0)
    print(f"correlation of the z-MIPs: {correlation(ours[2].mip('z'), image.max(axis=2)):.4f}")


def _ball(positions: np.ndarray, samples: int) -> np.ndarray:
    """Pressure of one Gaussian ball off the centre, in closed form."""
    place, width = np.array([0.6e-3, -0.3e-3, 1.5e-3]), 80e-6
    distance = np.sqrt(((positions - place[:2]) ** 2).sum(axis=1) + place[2] ** 2)[:, None]
    late = distance - SPEED * INTERVAL * np.arange(samples)
    early = distance + SPEED * INTERVAL * np.arange(samples)
    wave = late * np.exp(-(late**2) / 2 / width**2) + early * np.exp(-(early**2) / 2 / width**2)
    return (wave / 2 / distance).astype(np.float32)


def _measure(run):
    """Median seconds of three runs, peak bytes of one more, and its result."""
    run()
    seconds = []
    for _ in range(3):
        begin = time.perf_counter()
        run()
        seconds.append(time.perf_counter() - begin)
    tracemalloc.start()
    result = run()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return float(np.median(seconds)), peak, result


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
