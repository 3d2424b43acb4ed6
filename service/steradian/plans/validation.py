"""Validation of a plan against scanner, link, record length, sampling and disk."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from steradian.plans.plan import ScanPlan


DISK_MARGIN = 1.2
"""Warn when less than this times the need is free."""


@dataclass(frozen=True)
class PlanIssue:
    """Finding of a plan's validation: an error prevents the scan, a warning does not.

    Attributes
    ----------
    severity
        ``error`` or ``warning``.
    field
        The field of the plan to change.
    message
        What is wrong.
    allowed
        The range of the field that would do.
    """

    severity: Literal["error", "warning"]
    field: str
    message: str
    allowed: str = ""


def validate_plan(
    plan: ScanPlan, *, alines_per_second: float, bytes_: int, free: int | None, resolution: float | None
) -> tuple[PlanIssue, ...]:
    """Validate a plan against scanner, link, records, lateral spacing and disk; errors first."""
    found = [
        *_limits(plan),
        *_link(plan, alines_per_second),
        *_check_record_length(plan),
        *_spacing(plan, resolution),
        *_disk(bytes_, free),
    ]
    return tuple(sorted(found, key=lambda finding: finding.severity != "error"))


def _limits(plan: ScanPlan) -> Iterator[PlanIssue]:
    """Check every parameter of the plan against the scanner's range."""
    limits = plan.scanner
    for axis, name in enumerate("xy"):
        places = plan.beam_positions[:, axis]
        low, high = getattr(limits, name)
        beyond = (places < low - 1e-12) | (places > high + 1e-12)
        if beyond.any():
            worst = places[np.argmax(np.abs(places - (low + high) / 2))]
            message = f"{int(beyond.sum())} points lie out of the scanner's field, as far as {name} = {_mm(worst)}"
            yield PlanIssue("error", "mask.positions", message, f"{name} from {_mm(low)} to {_mm(high)}")
    for name, unit in (("pulse_rate", " Hz"), ("averages", ""), ("samples", ""), ("sampling_interval", " s")):
        low, high = getattr(limits, name)
        value = getattr(plan, name)
        if not low * (1 - 1e-9) <= value <= high * (1 + 1e-9):
            yield PlanIssue("error", name, f"the scanner cannot do {value:g}{unit}", f"{low:g} to {high:g}{unit}")
    if plan.bias is not None:
        low, high = limits.wavelength
        if plan.bias.min() < low or plan.bias.max() > high:
            span = f"{1e9 * plan.bias.min():.3f} to {1e9 * plan.bias.max():.3f} nm"
            yield PlanIssue(
                "error", "wavelengths", f"the laser does not reach {span}", f"{1e9 * low:g} to {1e9 * high:g} nm"
            )


def _link(plan: ScanPlan, alines_per_second: float) -> Iterator[PlanIssue]:
    """Check the rate of A-lines against the capacity of the link."""
    carried = plan.link.alines_per_second(plan.samples)
    if alines_per_second <= carried:
        return
    baud = plan.link.required_baud(alines_per_second, plan.samples)
    rate = plan.pulse_rate * carried / alines_per_second
    yield PlanIssue(
        "error",
        "pulse_rate",
        f"the scan makes {alines_per_second:.1f} A-lines a second of {plan.samples} samples, the link carries"
        f" {carried:.1f}; {baud:,} baud would do",
        f"at most {rate:.3g} Hz over this link",
    )


def _check_record_length(plan: ScanPlan) -> Iterator[PlanIssue]:
    """Check that the records include the sound from the point of interest at all sensors."""
    reach = plan.recording_depth
    for x, y, depth in plan.mask.points_of_interest:
        if depth > reach:
            need = _samples_for(plan, depth)
            message = f"the point of interest at {_mm(depth)} lies deeper than the records reach, {_mm(reach)}"
            yield PlanIssue("error", "samples", message, f"at least {need}")
            continue
        across = np.linalg.norm(plan.mask.film_positions - [x, y], axis=1).max()
        farthest = float(np.hypot(across, depth))
        if farthest > reach:
            need = _samples_for(plan, farthest)
            message = (
                f"{plan.samples} samples end before the farthest sensor, {_mm(farthest)} away, hears the point of"
                f" interest; at least {need}"
            )
            yield PlanIssue("warning", "samples", message, f"at least {need}")


def _samples_for(plan: ScanPlan, distance: float) -> int:
    return ceil(distance / plan.sound_speed / plan.sampling_interval) + 1


def _spacing(plan: ScanPlan, resolution: float | None) -> Iterator[PlanIssue]:
    """Check the mask's smallest spacing against half the desired resolution (Nyquist)."""
    if resolution is None:
        return
    spacing = float(plan.mask.weights.min()) ** (1 / plan.mask.positions.shape[1])
    if spacing > resolution / 2:
        wanted = f"{1e6 * resolution:.4g} µm"
        message = f"sensors {1e6 * spacing:.4g} µm apart at the densest alias structures of {wanted}"
        factor = (2 * spacing / resolution) ** plan.mask.positions.shape[1]
        allowed = f"a spacing of at most {5e5 * resolution:.4g} µm, about {ceil(plan.mask.count * factor):,} points"
        yield PlanIssue("warning", "mask", message, allowed)


def _disk(need: int, free: int | None) -> Iterator[PlanIssue]:
    """Check the disk space: an error below the scan's size, a warning below a margin."""
    if free is None or free >= DISK_MARGIN * need:
        return
    severity: Literal["error", "warning"] = "error" if free < need else "warning"
    message = f"the scan needs {need / 1e6:.1f} MB, the disk has {free / 1e6:.1f} MB"
    yield PlanIssue(severity, "disk", message, f"at least {need / 1e6:.1f} MB free")


def _mm(length: float) -> str:
    return f"{1e3 * length:.4g} mm"
