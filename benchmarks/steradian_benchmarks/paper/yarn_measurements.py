"""Measurements of the paper's section 6: 3 % of a yarn scan, by an equi-steradian mask against square grids.

The yarn is a closed-form knot, the scan 226 × 226 points with noise. Its reconstruction from all points is the model
standard, as in the paper; the truth, which the paper did not have, stands beside it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian import phantoms, quality
from steradian.imaging import Acquisition, DirectMethod, Gridded, ImageGrid, Nufft, Volume, reconstruct
from steradian.imaging.signal.conditioning import Conditioning
from steradian.masks import Mask, equi_steradian_mask
from steradian.masks.scanner_grid import ScannerGrid
from steradian_benchmarks.paper.sections import SectionContext, SectionResult

SIDE, PITCH, INTERVAL, SPEED, DEPTH = 226, 60e-6, 8e-9, 1480.0, 3.6e-3
SAMPLES, POINTS, GRID = 1024, 1600, 41
GRIDS = (2, 3, 4, 5)
SHOWN = (1e-3, 8e-3)
"""Depths in m that are reconstructed."""
LOW_PASS = 20e6
THRESHOLD = 0.04
EVALUATED_DIAMETERS = (2e-3, 8e-3)
DRAWN_DIAMETER = 8.4e-3
"""The disc of the paper's figure over the number of pixels."""
DECLARED = 7.2e-3
EQUI, FILLED = "equi-steradian", "gaps filled"


@dataclass(frozen=True, slots=True)
class ExperimentSetting:
    """Parameters of the simulated recording and reconstruction of the yarn.

    Parameters
    ----------
    noise_db
        Largest pressure over the noise's standard deviation; ``None``: no noise.
    low_pass
        Of the A-lines before the reconstruction, in Hz; ``None``: none.
    double
        Twice as many modes as the dense scan has points along a side: the paper's upsampling by 2.
    """

    noise_db: float | None = 30.0
    low_pass: float | None = LOW_PASS
    double: bool = True

    def words(self) -> str:
        """Return a short text that describes the setting."""
        noise = "no noise" if self.noise_db is None else f"{self.noise_db:g} dB noise"
        band = "all frequencies" if self.low_pass is None else f"to {self.low_pass / 1e6:g} MHz"
        return f"{noise}, {band}, {'twice the' if self.double else 'as many'} modes"


MAIN_SETTING = ExperimentSetting()
OTHER_SETTINGS = (
    ExperimentSetting(None, None),
    ExperimentSetting(30.0, None, False),
    ExperimentSetting(40.0, None),
    ExperimentSetting(30.0, None),
)


class PointSelection:
    """Points of a dense scan, and the subsets selected by masks.

    Parameters
    ----------
    quick
        A sixteenth of the points, four times as far apart.
    """

    def __init__(self, quick: bool) -> None:
        self.scale = 4 if quick else 1
        self.side, self.pitch = SIDE // self.scale, PITCH * self.scale
        self.aperture = self.side * self.pitch
        axis = (np.arange(self.side) - self.side // 2) * self.pitch
        self.positions = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)

    def equi_steradian(self) -> tuple[NDArray[np.int64], Mask]:
        """Return the indices of the equi-steradian mask's points in the dense scan, and the mask."""
        grid = ScannerGrid(count=self.side, interval=self.pitch)
        mask = equi_steradian_mask(self.aperture, DEPTH, POINTS // self.scale**2, grid=grid, weighting="analytic")
        columns = np.rint(mask.positions / self.pitch).astype(np.int64) + self.side // 2
        return columns[:, 0] * self.side + columns[:, 1], mask

    def grid(self, interval: int) -> NDArray[np.int64]:
        """Return the indices of a centred square grid of points in the dense scan."""
        count = GRID // self.scale
        line = self.side // 2 + (np.arange(count) - count // 2) * interval
        return (line[:, None] * self.side + line[None, :]).ravel()


class Scan(PointSelection):
    """Simulated dense scan of one object, and reconstructions from subsets of its points.

    Parameters
    ----------
    balls
        The object.
    setting
        Noise, filter, modes.
    seed
        Of the noise.
    quick
        Fewer points, and samples alike.
    """

    def __init__(self, balls: phantoms.Balls, setting: ExperimentSetting, seed: int, quick: bool) -> None:
        super().__init__(quick)
        self.setting = setting
        self.interval, samples = INTERVAL * self.scale, SAMPLES // self.scale
        clean = phantoms.pressure(
            balls, self.positions, samples=samples, sampling_interval=self.interval, sound_speed=SPEED
        )
        traces = clean if setting.noise_db is None else phantoms.add_noise(clean, setting.noise_db, seed=seed)
        if setting.low_pass is not None:
            traces = Conditioning(band=(None, setting.low_pass)).apply(
                traces, self.positions, sampling_interval=self.interval, aperture=self.aperture
            )
        self.traces = traces

    def image(
        self,
        points: NDArray[np.int64] | None,
        method: DirectMethod = Nufft(),
        weights: NDArray[np.float64] | None = None,
    ) -> Volume:
        """Reconstruct a volume from selected points of the scan; None: from all."""
        some: Any = slice(None) if points is None else points
        recorded: dict[str, Any] = {"dt": self.interval, "sound_speed": SPEED, "aperture": self.aperture}
        acquisition = Acquisition(self.traces[some], self.positions[some], weights=weights, **recorded)
        return reconstruct(acquisition, ImageGrid(self.side * (2 if self.setting.double else 1), depth=SHOWN), method)


def cases(quick: bool) -> list[tuple[str, int, ExperimentSetting]]:
    """Return the experiments: objects, seeds and settings; the first one is drawn."""
    seeds = range(1 if quick else 5)
    found = [("yarn", seed, MAIN_SETTING) for seed in seeds]
    found += [("vessels", seed, MAIN_SETTING) for seed in list(seeds)[:2]]
    return found + [("yarn", 0, other) for other in (OTHER_SETTINGS[:1] if quick else OTHER_SETTINGS)]


def measure(run: SectionContext) -> SectionResult:
    """Measure the image quality of all masks on all objects and settings."""
    chosen, rows = cases(run.quick), []
    for done, case in enumerate(chosen):
        run.step(done, len(chosen))
        rows.append(measure_case(run, *case, draw=done == 0))
    run.step(len(chosen), len(chosen))
    points = PointSelection(run.quick)
    _, mask = points.equi_steradian()
    return {
        "points": mask.count,
        "grid_points": len(points.grid(2)),
        "of": len(points.positions),
        "weight_ratio": mask.weight_ratio,
        "diameters_mm": _diameters(),
        "main": MAIN_SETTING.words(),
        "rows": rows,
    }


def measure_case(run: SectionContext, kind: str, seed: int, setting: ExperimentSetting, *, draw: bool) -> SectionResult:
    """Measure the image quality of all masks on one object under one setting."""
    balls: phantoms.Balls = getattr(phantoms, kind)(seed)
    row = _row(run, Scan(balls, setting, seed, run.quick), balls, draw=draw)
    return {"object": kind, "seed": seed, "setting": setting.words(), **row}


def _diameters() -> list[float]:
    return [round(float(d), 1) for d in np.arange(2.0, 12.01, 0.4)]


def _row(run: SectionContext, scan: Scan, balls: phantoms.Balls, *, draw: bool) -> SectionResult:
    full = scan.image(None)
    model, truth = full.mip("z"), phantoms.rasterise(balls, full)
    points, mask = scan.equi_steradian()
    choices = {EQUI: partial(scan.image, points, weights=mask.weights)}
    choices |= {f"interval {k}": partial(scan.image, scan.grid(k)) for k in GRIDS}
    choices[FILLED] = partial(scan.image, points, Gridded())
    figures, mips = {}, {}
    for name, make in choices.items():
        volume = make()
        mips[name] = volume.mip("z")
        figures[name] = _figures(volume, model, truth)
    best = max((f"interval {k}" for k in GRIDS), key=lambda name: float(np.mean(near(figures[name]["by_diameter"]))))
    interest = quality.above_threshold(model, THRESHOLD)
    inside = quality.disc(full.axes.x, _y(full), DRAWN_DIAMETER)
    row: SectionResult = {
        "masks": figures,
        "best": best,
        "full_truth_mip": quality.correlation(model, truth.mip("z")),
        "full_truth_volume": _volume_correlation(full, truth),
        "pixels": int((interest & inside).sum()),
        "share_of_disc": float((interest & inside).sum() / inside.sum()),
    }
    if draw:
        row["by_pixels"] = _by_pixels(full, model, mips)
        _draw(run, scan, full, mips, row)
    return row


def _figures(volume: Volume, model: NDArray[Any], truth: Volume) -> SectionResult:
    image, interest = volume.mip("z"), quality.above_threshold(model, THRESHOLD)
    correlations, sharpness = [], []
    for diameter in _diameters():
        region = interest & quality.disc(volume.axes.x, _y(volume), 1e-3 * diameter)
        correlations.append(_correlation(image, model, region))
        peak = float(image[region].max()) if region.any() else 0.0
        sharpness.append(quality.tenenbaum(255 / peak * image, region) if peak > 0 else None)
    declared = quality.disc(volume.axes.x, _y(volume), DECLARED)
    return {
        "by_diameter": correlations,
        "sharpness": sharpness,
        "declared": quality.correlation(image, model, interest & declared),
        "truth_mip": quality.correlation(image, truth.mip("z"), declared),
        "truth_volume": _volume_correlation(volume, truth),
    }


def _volume_correlation(volume: Volume, truth: Volume) -> float:
    """Return the correlation of two volumes over every second column along x and y, to save time."""
    return quality.correlation(volume.values[::2, ::2], truth.values[::2, ::2])


def _correlation(a: NDArray[Any], b: NDArray[Any], region: NDArray[np.bool_]) -> float | None:
    return quality.correlation(a, b, region) if region.sum() > 10 else None


def _by_pixels(full: Volume, model: NDArray[Any], mips: dict[str, NDArray[Any]]) -> SectionResult:
    """Return the correlation over the n brightest pixels of the reference in the disc, for increasing n."""
    inside = np.flatnonzero(quality.disc(full.axes.x, _y(full), DRAWN_DIAMETER).ravel())
    order = inside[np.argsort(-model.ravel()[inside], kind="stable")]
    counts = [int(n) for n in np.linspace(0.02, 1.0, 25) * len(order)]
    chosen = {
        name: [_pearson(mip.ravel()[order[:n]], model.ravel()[order[:n]]) for n in counts]
        for name, mip in mips.items()
        if name != FILLED
    }
    return {"counts": counts, "correlation": chosen}


def _pearson(a: NDArray[Any], b: NDArray[Any]) -> float:
    return quality.correlation(a, b)


def _y(volume: Volume) -> NDArray[np.float64]:
    assert volume.axes.y is not None
    return volume.axes.y


def near(values: list[float | None]) -> list[float]:
    """Return the values for discs of 2 to 8 mm."""
    low, high = (1e3 * d for d in EVALUATED_DIAMETERS)
    return [v for d, v in zip(_diameters(), values, strict=True) if low <= d <= high and v is not None]


def _draw(run: SectionContext, scan: Scan, full: Volume, mips: dict[str, NDArray[Any]], row: SectionResult) -> None:
    from steradian_benchmarks.paper.pictures import curves, figure, save, show

    x, y, z = full.axes.x, _y(full), full.axes.z
    made, panels = figure(9.5, 3.3, 1, 3)
    for axes, axis, plane in zip(panels, ("z", "y", "x"), ("xy", "xz", "yz"), strict=True):
        across, up = {"xy": (x, y), "xz": (x, z), "yz": (y, z)}[plane]
        show(axes, full.mip(axis), across, up, f"all {len(scan.positions):,} points", plane)  # type: ignore[arg-type]
    save(made, run.picture("yarn-full"))
    made, panels = figure(8, 8, 2, 2)
    points, _ = scan.equi_steradian()
    for column, (name, some) in enumerate(((EQUI, points), ("interval 5", scan.grid(5)))):
        where = 1e3 * scan.positions[some]
        panels[column].plot(where[:, 0], where[:, 1], ".", markersize=1.5, color="black")
        panels[column].set_aspect("equal")
        panels[column].set_title(f"{name}, {len(some):,} points", fontsize=9)
        panels[column].tick_params(labelsize=7)
        half = 500 * scan.aperture
        panels[column].set(xlim=(-half, half), ylim=(-half, half))
        show(panels[2 + column], mips[name], x, y, f"{name}, reconstructed")
    save(made, run.picture("yarn-masks"))
    made, panels = figure(9.5, 3.2, 1, 3)
    by_pixels, masks = row["by_pixels"], row["masks"]
    label = "correlation"
    curves(panels[0], by_pixels["counts"], by_pixels["correlation"], ("pixels of interest", label), bold=EQUI)
    names = [name for name in masks if name != FILLED]
    for axes, key, what in zip(panels[1:], ("by_diameter", "sharpness"), (label, "sharpness"), strict=True):
        series = {name: masks[name][key] for name in names}
        curves(axes, _diameters(), series, ("diameter of the disc (mm)", what), bold=EQUI)
    save(made, run.picture("yarn-curves"))
