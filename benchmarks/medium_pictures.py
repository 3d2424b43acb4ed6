"""Pictures of docs/medium.md: what one speed does to two layers, and what compensation gives back.

``python benchmarks/medium_pictures.py [FOLDER]`` writes ``layers.png`` and ``attenuation.png``
(``docs/medium`` by itself) in some ten seconds.
"""

from __future__ import annotations

import io
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from steradian import Acquisition, Compute, ImageGrid, Layer, Medium, Volume, equi_steradian_mask, reconstruct
from steradian.imaging import ATTENUATIONS
from steradian.phantoms import Balls, add_noise, layered_pressure
from steradian_benchmarks.paper.pictures import few_colours

INTERVAL, SAMPLES, SIDE = 8e-9, 1200, 13.56e-3
MASK = equi_steradian_mask(SIDE, 3.6e-3, 1600)


def volume(balls: Balls, acquired: Medium, imaged_as: Medium, depths: tuple[float, float]) -> Volume:
    """Return the direct image of balls with noise 30 dB below the largest sample."""
    traces = layered_pressure(balls, MASK.positions, acquired, samples=SAMPLES, sampling_interval=INTERVAL)
    acquisition = Acquisition(add_noise(traces, 30.0), MASK, dt=INTERVAL, medium=imaged_as)
    return reconstruct(acquisition, ImageGrid(226, depth=depths), compute=Compute(device="cpu"))


def layers() -> Figure:
    """Draw balls in and below water over tissue, imaged with one speed and with two."""
    x = np.linspace(-2e-3, 2e-3, 5)
    centres = np.array([(offset, 0.0, depth) for depth in (1.2e-3, 3e-3, 4.4e-3) for offset in x])
    balls = Balls(centres, np.full(len(centres), 50e-6), np.ones(len(centres)))
    medium = Medium([Layer(1480.0, 2e-3), Layer(1580.0)])
    images = {
        "one speed, 1530 m/s": volume(balls, medium, Medium([Layer(1530.0)]), (0.8e-3, 5e-3)),
        "1480 m/s to 2 mm, 1580 m/s": volume(balls, medium, medium, (0.8e-3, 5e-3)),
    }
    return draw(images, (-2.6, 2.6), centres, boundary=2.0)


def attenuation() -> Figure:
    """Draw balls of 30, 50 and 100 µm in soft tissue: lossless, as it is, and compensated."""
    depths, sizes = (2e-3, 4e-3, 6e-3, 8e-3), (30e-6, 50e-6, 100e-6)
    centres = np.array([((i - 1) * 1e-3, 0.0, depth) for depth in depths for i in range(3)])
    balls = Balls(centres, np.tile(sizes, len(depths)), np.ones(len(centres)))
    tissue = Medium([Layer(1500.0, attenuation=ATTENUATIONS["soft tissue"])])
    lossless = tissue.lossless
    images = {
        "without attenuation": volume(balls, lossless, lossless, (1.4e-3, 9e-3)),
        "soft tissue, as it is": volume(balls, tissue, lossless, (1.4e-3, 9e-3)),
        "compensated": volume(balls, tissue, tissue, (1.4e-3, 9e-3)),
    }
    return draw(images, (-1.6, 1.6), centres)


def draw(
    images: dict[str, Volume], across: tuple[float, float], centres: np.ndarray, boundary: float | None = None
) -> Figure:
    """Return a figure of slices through the balls, in shares of the values that they have without a fault."""
    best = list(images.values())[0 if boundary is None else -1]
    figure = Figure(figsize=(3.0 * len(images), 2.6 if boundary else 5.2), dpi=90, layout="constrained")
    depths = np.unique(centres[:, 2])
    # with the depth the aperture sees less of a ball: brightness is in shares of the balls at each depth
    near = [np.abs(best.axes.z - depth) < 0.2e-3 for depth in depths]
    middle = len(best.axes.x) // 2
    largest = np.array([best.values[:, middle, some].max() for some in near])
    for number, (title, image) in enumerate(images.items(), start=1):
        axes = figure.add_subplot(1, len(images), number)
        z, x = 1e3 * image.axes.z, 1e3 * image.axes.x
        shown = image.values[:, middle] / np.interp(image.axes.z, depths, largest)
        extent = (x[0], x[-1], z[-1], z[0])
        axes.imshow(shown.T, extent=extent, vmin=0, vmax=1, cmap="inferno", aspect="equal")
        if boundary is not None:
            axes.axhline(boundary, color="white", linewidth=0.6, linestyle="--")
            axes.plot(1e3 * centres[:, 0], 1e3 * centres[:, 2], "+", color="deepskyblue", markersize=4)
        axes.set_xlim(*across)
        axes.set_title(title, fontsize=9)
        axes.set_xlabel("x (mm)")
        if number == 1:
            axes.set_ylabel("depth (mm)")
    return figure


def main(folder: str = "docs/medium") -> None:
    """Write the pictures."""
    for name, figure in (("layers", layers()), ("attenuation", attenuation())):
        file = io.BytesIO()
        figure.savefig(file, format="png")
        few_colours(Image.open(file).convert("RGB")).save(Path(folder) / f"{name}.png", "png", optimize=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
