"""Measurements of the paper's section 3: NER against linear interpolation in frequency, on a bar chart and a star.

Both targets lie 4 mm deep under 146 × 146 points 70 µm apart. They are closed-form balls of s = 9 µm, whose spectrum
falls to −3 dB at 22 MHz as the film's does, so the sharpest line that the data hold is 21 µm wide.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian import phantoms, quality
from steradian.core.exceptions import InvalidInput
from steradian.imaging import (
    AcquisitionGeometry,
    Compute,
    DirectMethod,
    ImageGrid,
    LinearKappa,
    NearestKappa,
    Ner,
    ReconstructionPlan,
    Volume,
)
from steradian.phantoms.targets import SIGMA, chart_bars
from steradian_benchmarks.paper.sections import SectionContext, SectionResult

SIDE, PITCH, INTERVAL, SPEED, DEPTH = 146, 70e-6, 8e-9, 1480.0, 4e-3
NOISE_DB, SAMPLES, SHORT = 30.0, 1024, 512
SECTORS, INNER = 72, 3e-3
"""Of the star; beyond the inner 3 of its 5 mm there are fewer than 4 line pairs per mm."""
DENSITIES = (5, 6, 8, 10, 11, 12)
"""Line pairs per mm at which the star is looked at."""
SHOWN = (3.4e-3, 4.6e-3)
NARROWEST = 180e-6
"""Bars narrower than this have too few points on an edge to fit."""
KWAVE = "linear, modes as sensors"
"""What k-Wave's function for planes does; its image is upsampled here so that edges have as many points."""
METHODS: dict[str, dict[str, Any]] = {
    "NER": {"method": Ner()},
    "linear": {"method": LinearKappa()},
    "linear, modes as sensors": {"method": LinearKappa(), "finer": 1, "upsampling": 2},
    "linear, record doubled with zeros first": {"method": LinearKappa(), "time_padding": 2.0},
    "nearest": {"method": NearestKappa()},
}


class Target:
    """Simulated resolution target and its A-lines.

    Parameters
    ----------
    balls
        The target.
    run
        Whether all is small.
    """

    def __init__(self, balls: phantoms.Balls, run: SectionContext) -> None:
        self.side = 48 if run.quick else SIDE
        self.aperture = self.side * PITCH
        axis = (np.arange(self.side) - self.side // 2) * PITCH
        self.positions = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
        clean = phantoms.pressure(balls, self.positions, samples=SAMPLES, sampling_interval=INTERVAL, sound_speed=SPEED)
        self.traces = phantoms.add_noise(clean, NOISE_DB)

    def plan(
        self, *, method: DirectMethod, samples: int = SAMPLES, finer: int = 2, depths: bool = True, **voxels: Any
    ) -> ReconstructionPlan:
        """Create a reconstruction plan with ``finer`` times as many lateral modes as sensors."""
        geometry = AcquisitionGeometry(self.positions, samples, dt=INTERVAL, sound_speed=SPEED, aperture=self.aperture)
        grid = ImageGrid(finer * self.side, depth=SHOWN if depths else None, **voxels)
        return ReconstructionPlan(geometry, grid, method, compute=Compute(device="cpu"))

    def image(self, *, samples: int = SAMPLES, **options: Any) -> Volume:
        """Reconstruct the depths around the target."""
        volume = self.plan(samples=samples, **options).run(self.traces[:, :samples])
        assert isinstance(volume, Volume)
        return volume

    def seconds(self, repeats: int) -> dict[str, dict[str, float]]:
        """Time NER and linear interpolation of the whole volume; return medians of wall-clock and processor time."""
        plans = {name: self.plan(depths=False, **METHODS[name]) for name in ("NER", "linear")}
        times: dict[str, list[tuple[float, float]]] = {name: [] for name in plans}
        for _ in range(repeats + 1):
            for name, plan in plans.items():
                begin = time.perf_counter(), time.process_time()
                plan.run(self.traces)
                times[name].append((time.perf_counter() - begin[0], time.process_time() - begin[1]))
        medians = {name: np.median(found[1:], axis=0) for name, found in times.items()}
        return {name: {"wall": float(wall), "processor": float(cpu)} for name, (wall, cpu) in medians.items()}


def measure(run: SectionContext) -> SectionResult:
    """Measure line and edge widths, modulation and reconstruction times."""
    steps = 5
    run.step(0, steps)
    size, groups = (1.2e-3, 2) if run.quick else (3e-3, 4)
    layout = {"size": size, "groups": groups}
    chart = Target(phantoms.chart(depth=DEPTH, **layout), run)  # type: ignore[arg-type]
    run.step(1, steps)
    bars = chart_bars(**layout)  # type: ignore[arg-type]
    rows = []
    for samples in (SAMPLES, SHORT):
        volumes = {name: chart.image(samples=samples, **options) for name, options in METHODS.items()}
        rows += [{"method": name, "samples": samples, **_widths(v, bars)} for name, v in volumes.items()]
        if samples == SAMPLES:
            _draw_chart(run, volumes["linear"], volumes["NER"], bars)
    run.step(2, steps)
    repeats = 1 if run.quick else 5
    seconds = {"chart": chart.seconds(repeats)}
    del chart, volumes
    diameter = 2.4e-3 if run.quick else INNER
    star = Target(phantoms.star(sectors=SECTORS, diameter=diameter, depth=DEPTH), run)
    run.step(3, steps)
    seconds["star"] = star.seconds(repeats)
    images = {name: star.image(**METHODS[name]) for name in ("NER", "linear", KWAVE)}
    images["NER, modes as sensors"] = star.image(finer=1, method=Ner())
    images["NER, modes as sensors, image upsampled"] = star.image(finer=1, method=Ner(), upsampling=2)
    modulation = {name: _modulations(volume) for name, volume in images.items()}
    _draw_star(run, {name: images[name] for name in (KWAVE, "linear", "NER")})
    run.step(steps, steps)
    return {
        "rows": rows,
        "object": {"axial": _object_width(), "direct": 1e6 * SIGMA * 2 * np.sqrt(2 * np.log(2))},
        "seconds_of": seconds,
        "densities": list(DENSITIES),
        "modulation": modulation,
    }


def _widths(volume: Volume, bars: Sequence[tuple[float, float, float, float]]) -> SectionResult:
    """Measure resolution: 49 line-spread fits along z in a wide bar, and edge-spread fits of the wide bars."""
    x, y, z = volume.axes.x, _y(volume), volume.axes.z
    left, right, low, high = bars[1]
    i, j = _nearest(x, (left + right) / 2), _nearest(y, (low + high) / 2)
    lines = [volume.values[a, b] for a in range(i - 3, i + 4) for b in range(j - 3, j + 4)]
    axial, direct = [], []
    for line in lines:
        positive = np.clip(line, 0, None)  # intensities: a limited view leaves negative values beside a line
        direct.append(1e6 * quality.direct_fwhm(z, positive, base=0.0))
        try:
            axial.append(1e6 * quality.line_spread(z, positive).fwhm)
        except InvalidInput:
            continue
    lateral, edges = _edges(volume.mip("z"), x, y, bars)
    return {
        "axial": _summary(axial),
        "axial_direct": _summary(direct),
        "axial_fits": len(axial),
        "lateral": _summary(lateral),
        "lateral_direct": _summary(edges),
        "edges": len(lateral),
        "peak": float(np.mean([line.max() for line in lines])),
    }


def _edges(
    image: NDArray[Any],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    bars: Sequence[tuple[float, float, float, float]],
) -> tuple[list[float], list[float]]:
    """Fit the edge spread of both long sides of each wide bar; return fitted and model-free widths in µm.

    Fits that are uncertain by a third of the width or wider than the bar are left out; the paper does likewise.
    """
    fitted, direct = [], []
    for left, right, low, high in bars:
        width = min(right - left, high - low)
        if width < NARROWEST:
            continue
        upright = high - low > right - left
        across, ends = (x, (left, right)) if upright else (y, (low, high))
        middle = _nearest(y, (low + high) / 2) if upright else _nearest(x, (left + right) / 2)
        profile = image[:, middle] if upright else image[middle]
        for edge in ends:
            some = np.abs(across - edge) < width / 2
            try:
                spread = quality.edge_spread(across[some], np.clip(profile[some], 0, None))
            except InvalidInput:
                continue
            if spread.standard_error > spread.fwhm / 3 or spread.fwhm > width:
                continue
            fitted.append(1e6 * spread.fwhm)
            direct.append(1e6 * spread.direct_fwhm)
    return fitted, direct


def _summary(values: Sequence[float]) -> list[float | None]:
    """Return mean and standard deviation of the finite values."""
    finite = [value for value in values if np.isfinite(value)]
    return [float(np.mean(finite)), float(np.std(finite))] if finite else [None, None]


def _object_width() -> list[float | None]:
    """Return the axial width of the true object in the same fit of eight points, over all sample offsets."""
    z = SPEED * INTERVAL * np.arange(-20, 21)
    found = []
    for shift in np.linspace(-0.5, 0.5, 21) * SPEED * INTERVAL:
        try:
            found.append(1e6 * quality.line_spread(z, np.exp(-((z - shift) ** 2) / (2 * SIGMA**2))).fwhm)
        except InvalidInput:
            continue
    return _summary(found)


def _modulations(volume: Volume) -> list[float | None]:
    """Return the modulation depth of the star's line pairs on circles, from their Fourier component."""
    from scipy.ndimage import map_coordinates

    image, x, y = np.clip(volume.mip("z"), 0, None), volume.axes.x, _y(volume)
    found: list[float | None] = []
    for density in DENSITIES:
        radius = SECTORS / 2 / (2 * np.pi * density) * 1e-3
        angle = 2 * np.pi * np.arange(4096) / 4096
        places = [(radius * np.cos(angle) - x[0]) / (x[1] - x[0]), (radius * np.sin(angle) - y[0]) / (y[1] - y[0])]
        circle = map_coordinates(image, places, order=1)
        component = np.mean(circle * np.exp(-1j * angle * SECTORS / 2))
        found.append(float(2 * np.abs(component) / np.mean(circle)))
    return found


def _draw_chart(
    run: SectionContext, linear: Volume, ner: Volume, bars: Sequence[tuple[float, float, float, float]]
) -> None:
    from steradian_benchmarks.paper.pictures import curves, figure, save, show

    made, panels = figure(8, 7, 2, 2)
    x, y, z = ner.axes.x, _y(ner), ner.axes.z
    left, right, low, high = bars[1]
    i, j = _nearest(x, (left + right) / 2), _nearest(y, (low + high) / 2)
    for axes, (name, volume) in zip(panels, (("linear", linear), ("NER", ner)), strict=False):
        show(axes, volume.mip("z"), x, y, f"chart, {name}")
        axes.plot([1e3 * left, 1e3 * left], [1e3 * low, 1e3 * high], color="tab:cyan", linewidth=1)
        axes.plot(1e3 * x[i], 1e3 * y[j], "s", color="tab:red", markersize=4)
    both = (("linear", linear), ("NER", ner))
    near = np.abs(z - DEPTH) < 100e-6
    lines: dict[str, Sequence[float | None]] = {name: v.values[i, j][near].tolist() for name, v in both}
    curves(panels[2], (1e3 * z[near]).tolist(), lines, ("z (mm)", "a line along z (red square)"))
    some = np.abs(x - left) < (right - left) / 2
    lines = {name: v.mip("z")[some, j].tolist() for name, v in both}
    curves(panels[3], (1e3 * x[some]).tolist(), lines, ("x (mm)", "across an edge (blue)"))
    save(made, run.picture("chart"))


def _draw_star(run: SectionContext, images: dict[str, Volume]) -> None:
    from steradian_benchmarks.paper.pictures import curves, figure, save, show

    made, panels = figure(9.5, 3.4, 1, 3)
    for axes, name in zip(panels, (KWAVE, "NER"), strict=False):
        x, y = images[name].axes.x, _y(images[name])
        middle = np.abs(x) < 1.2e-3
        show(axes, images[name].mip("z")[np.ix_(middle, middle)], x[middle], y[middle], f"star, {name}")
        turn = np.linspace(0, 2 * np.pi, 200)
        radius = SECTORS / 2 / (2 * np.pi * 10)
        axes.plot(radius * np.cos(turn), radius * np.sin(turn), ":", color="tab:cyan", linewidth=1)
    lines: dict[str, Sequence[float | None]] = {name: _modulations(volume) for name, volume in images.items()}
    curves(panels[2], DENSITIES, lines, ("line pairs per mm", "modulation"), bold="NER")
    save(made, run.picture("star"))


def _nearest(axis: NDArray[np.float64], where: float) -> int:
    return int(np.abs(axis - where).argmin())


def _y(volume: Volume) -> NDArray[np.float64]:
    assert volume.axes.y is not None
    return volume.axes.y
