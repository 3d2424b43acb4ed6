"""Comparison of several masks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from steradian.comparisons.mask_metrics import MaskMetricsRow, Point, evaluate
from steradian.comparisons.simulation import METHODS, Method, Simulation, SimulationResult
from steradian.comparisons.staged_scan import StagedScan
from steradian.core.exceptions import Cancelled, InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.imaging import Volume
from steradian.masks import Mask
from steradian.masks.point_spread import PointSpread
from steradian.phantoms import Balls

Region = Literal["around", "field"]
REGIONS: dict[Region, str] = {"around": "around the point of interest", "field": "whole field"}


@dataclass(frozen=True)
class Comparison:
    """Comparison of masks: metrics of each, and figures of an object reconstructed through it.

    Attributes
    ----------
    masks
        By name.
    point_of_interest
        x, y, z in metres, the same for all.
    pulse_rate
        In Hz.
    promised, spreads
        Figures, and the image of a small ball at the point of interest, by the mask's name.
    simulation
        How the object was scanned, if it was.
    simulated
        What became of it, by the mask's name.
    """

    masks: dict[str, Mask]
    point_of_interest: Point
    pulse_rate: float
    promised: dict[str, MaskMetricsRow]
    spreads: dict[str, PointSpread]
    simulation: Simulation | None
    simulated: dict[str, SimulationResult]

    def ranking(self, region: Region, method: Method) -> list[tuple[str, float]]:
        """Return names and correlations of the volumes, best first."""
        found = [(name, float(getattr(each.by[method], region))) for name, each in self.simulated.items()]
        return sorted(found, key=lambda pair: -pair[1])

    @property
    def methods(self) -> tuple[Method, ...]:
        """Names of the reconstruction methods that were compared."""
        tried = next(iter(self.simulated.values())).by if self.simulated else {}
        return tuple(method for method in METHODS if method in tried)

    def as_json(self) -> dict[str, Any]:
        """Return all figures as JSON values; lengths in metres."""
        told: dict[str, Any] = {"point_of_interest_m": list(self.point_of_interest), "pulse_rate_hz": self.pulse_rate}
        if self.simulation is not None:
            told |= {"region_m": self.simulation.region, "noise_db": self.simulation.noise}
            told["winners"] = {
                method: {region: self.ranking(region, method)[0][0] for region in REGIONS} for method in self.methods
            }
        told["masks"] = {name: self._row(name) for name in self.masks}
        return told

    def _row(self, name: str) -> dict[str, Any]:
        row: dict[str, Any] = {
            "arrangement": self.masks[name].arrangement.get("arrangement"),
            "id": self.masks[name].id,
        }
        row |= {key: value if np.isfinite(value) else None for key, value in asdict(self.promised[name]).items()}
        if name in self.simulated:
            row["correlation"] = {
                method: {part: getattr(outcome, part) for part in ("around", "field", "around_mip", "field_mip")}
                for method, outcome in self.simulated[name].by.items()
            }
        return row


def compare_masks(
    masks: Mapping[str, Mask | StagedScan],
    *,
    point_of_interest: Point | None = None,
    pulse_rate: float = 50.0,
    noise: float = 30.0,
    phantom: Balls | Volume | None = None,
    region: float | None = None,
    modes: int | None = None,
    iterations: int = 30,
    seed: int = 0,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> Comparison:
    """Compare masks by their metrics and, with an object, by simulated images.

    Parameters
    ----------
    masks
        Two or more masks of a plane, by name; or scans in stages, which are simulated with the object.
    point_of_interest
        x, y, z in metres, for all masks the same; ``None``: that of the first mask that has one.
    pulse_rate
        Of the laser in Hz.
    noise
        Peak over the noise's standard deviation in dB, of the small ball's A-lines and of the object's.
    phantom
        An object (:mod:`steradian.phantoms`) or a volume of initial pressure; ``None``: none.
    region
        Diameter in metres of what counts as *around* the point of interest; ``None``: twice its depth.
    modes
        Voxels on each lateral axis of the reconstructions; ``None``: of 60 µm.
    iterations
        Of the iterative reconstruction; 0 leaves it out.
    seed
        Of the noise.
    progress, cancelled
        See :mod:`steradian.core.progress`.

    Raises
    ------
    InvalidInput
        When there are fewer than two masks, one is a line, a scan in stages has no object, no mask has a point of
        interest and none is given, or a figure is out of range.
    Cancelled
        When ``cancelled`` said so.
    """
    if len(masks) < 2:
        raise InvalidInput("masks", f"{len(masks)}", "two or more")
    for name, mask in masks.items():
        if isinstance(mask, StagedScan):
            if phantom is None:
                raise InvalidInput(f"masks[{name}]", "a scan in stages", "with a phantom, which its survey shows")
        elif mask.is_line:
            raise InvalidInput(f"masks[{name}]", "a line of sensors", "a mask of a plane")
    point = point_of_interest or _point_of_interest(masks)
    simulation = None
    if phantom is not None:
        size = 2 * point[2] if region is None else region
        simulation = Simulation(phantom, point[:2], size, noise, modes, iterations=iterations, seed=seed)
    figures: dict[str, MaskMetricsRow] = {}
    spreads: dict[str, PointSpread] = {}
    simulated: dict[str, SimulationResult] = {}
    built: dict[str, Mask] = {}
    for done, (name, candidate) in enumerate(masks.items()):
        if cancelled and cancelled():
            raise Cancelled("the comparison was stopped")
        if progress:
            progress("masks", done, len(masks))
        built[name] = mask = _build(candidate, simulation, cancelled)
        figures[name], spreads[name] = evaluate(mask, point, pulse_rate=pulse_rate, noise=noise)
        if simulation is not None:
            simulated[name] = simulation.simulate(
                mask, progress=_prefixed_progress(progress, name), cancelled=cancelled
            )
    if progress:
        progress("masks", len(masks), len(masks))
    return Comparison(built, point, pulse_rate, figures, spreads, simulation, simulated)


def _build(candidate: Mask | StagedScan, simulation: Simulation | None, cancelled: CancelCheck | None) -> Mask:
    if isinstance(candidate, Mask):
        return candidate
    assert simulation is not None  # noqa: S101 - a scan in stages has an object
    return candidate.build(simulation, cancelled=cancelled)[0]


def _point_of_interest(masks: Mapping[str, Mask | StagedScan]) -> Point:
    for mask in masks.values():
        if isinstance(mask, Mask) and len(mask.points_of_interest):
            x, y, z = mask.points_of_interest[0]
            return float(x), float(y), float(z)
    raise InvalidInput("point_of_interest", "missing", "x, y, z in metres; none of the masks has one")


def _prefixed_progress(progress: Progress | None, name: str) -> Progress | None:
    """Return a progress callback that prefixes stages with the mask's name."""
    if progress is None:
        return None
    report = progress
    return lambda stage, done, total: report(f"{name}, {stage}", done, total)
