"""A page of pictures of a mask: where it senses, how densely, what it can see and how sharply."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from steradian.masks.limited_view import limited_view
from steradian.masks.mask import Mask
from steradian.masks.point_spread import point_spread
from steradian.masks.promises import density_map, promises

RESOLUTION = 120
MM = 1e3


def draw_mask(mask: Mask, path: Path, *, deepest: float | None = None, with_point_spread: bool = True) -> None:
    """Draw a mask into a picture file; the ending of its name decides the format.

    Parameters
    ----------
    mask
        The mask.
    path
        The file, for example ``mask.png``; written whole or not at all.
    deepest
        Depth in metres down to which the limited view is shown; ``None`` for twice the point of interest's.
    with_point_spread
        Whether to simulate and reconstruct a tiny ball at the point of interest (about a second).
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 9), dpi=RESOLUTION, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 2)
    _draw_points(figure, axes[0, 0], mask)
    _draw_density(figure, axes[0, 1], mask)
    _draw_view(figure, axes[1, 0], mask, deepest)
    _draw_spread(figure, axes[1, 1], mask, with_point_spread)
    figure.suptitle(f"{mask.arrangement.get('arrangement', 'mask')}, {mask.count:,} points — {mask.id}")
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(path.name + ".new")
    figure.savefig(draft, format=path.suffix.lstrip(".") or "png")
    draft.replace(path)


def _draw_points(figure: Any, axes: Any, mask: Mask) -> None:
    x, y = MM * mask.film_positions.T
    size = float(np.clip(12_000 / mask.count, 0.3, 30))
    unit = "mm" if mask.is_line else "mm²"
    shown = axes.scatter(x, y, c=mask.weights * MM ** mask.positions.shape[1], s=size, cmap="viridis", linewidths=0)
    figure.colorbar(shown, ax=axes, label=f"weight ({unit})")
    half = MM * mask.aperture / 2
    axes.add_patch(_rectangle(-half, -half, 2 * half, 2 * half))
    for focus in mask.points_of_interest:
        axes.plot(MM * focus[0], MM * focus[1], "+", color="crimson", markersize=12)
    axes.set(title="Sensors, point of interest +", xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
    axes.set(xlim=(-1.05 * half, 1.05 * half), ylim=(-1.05 * half, 1.05 * half))


def _draw_density(figure: Any, axes: Any, mask: Mask) -> None:
    if mask.is_line:
        axes.plot(MM * mask.positions[:, 0], MM * promises(mask).spacing, ".-")
        axes.set(title="Distance to the nearest sensor", xlabel="x (mm)", ylabel="mm")
        return
    half = MM * mask.aperture / 2
    shown = axes.imshow(
        1e6 / np.sqrt(density_map(mask)).T, origin="lower", extent=(-half, half, -half, half), cmap="magma_r"
    )
    figure.colorbar(shown, ax=axes, label="spacing (µm)")
    axes.set(title="Spacing of the sensors", xlabel="x (mm)", ylabel="y (mm)")


def _draw_view(figure: Any, axes: Any, mask: Mask, deepest: float | None) -> None:
    depth = deepest or (2 * float(mask.points_of_interest[:, 2].max()) if mask.depth else mask.aperture / 2)
    view = limited_view(mask, depth)
    half = MM * mask.aperture / 2
    shown = axes.imshow(
        100 * view.share.T, extent=(-half, half, MM * depth, 0), aspect="auto", cmap="cividis", vmin=0, vmax=100
    )
    figure.colorbar(shown, ax=axes, label="visible edge orientations (%)")
    angle = np.degrees(np.minimum(view.steepest_left, view.steepest_right))
    lines = axes.contour(MM * view.x, MM * view.z, angle.T, levels=[15, 30, 45, 60, 75], colors="white", linewidths=0.8)
    axes.clabel(lines, fmt="%d°", fontsize=8)
    for place in mask.film_positions[:, 0].min(), mask.film_positions[:, 0].max():
        axes.axvline(MM * place, color="white", linestyle=":")
    for focus in mask.points_of_interest:
        axes.plot(MM * focus[0], MM * focus[2], "+", color="crimson", markersize=12)
    axes.set(title="Limited view: tilt of edges seen from both sides", xlabel="x (mm)", ylabel="depth (mm)")


def _draw_spread(figure: Any, axes: Any, mask: Mask, wanted: bool) -> None:
    if not wanted or not len(mask.points_of_interest):
        axes.axis("off")
        axes.text(0.5, 0.5, "no point of interest" if wanted else "not simulated", ha="center", color="grey")
        return
    spread = point_spread(mask)
    extent = (MM * spread.x[0], MM * spread.x[-1], MM * spread.z[-1], MM * spread.z[0])
    shown = axes.imshow(spread.section.T, extent=extent, cmap="gray", vmin=-0.2, vmax=1, interpolation="bilinear")
    figure.colorbar(shown, ax=axes, label="relative pressure")
    sizes = f"{1e6 * spread.lateral:.0f} µm wide, {1e6 * spread.axial:.0f} µm deep"
    axes.set(title=f"A ball of {1e6 * spread.true_width:.0f} µm: {sizes}", xlabel="x (mm)", ylabel="depth (mm)")


def _rectangle(x: float, y: float, width: float, height: float) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((x, y), width, height, fill=False, edgecolor="grey", linewidth=0.8)
