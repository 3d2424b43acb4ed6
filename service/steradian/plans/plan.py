"""Scan plan: a mask with the order and timing of its interrogation."""

from __future__ import annotations

from functools import cached_property
from itertools import pairwise
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from steradian.core.choices import VisitOrder
from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import SAMPLING_INTERVAL, SOUND_SPEED
from steradian.core.validation import FloatArray, content_hash, quantity_field
from steradian.drawing.displayable import DisplayableValue
from steradian.masks import Mask, subset_mask
from steradian.masks.multi_beam import MOST_BEAMS, NANOMETRE, check_beams
from steradian.plans.fringe import Fringe
from steradian.plans.motion_timing import MotionTiming
from steradian.plans.progressive_order import progressive
from steradian.plans.scanner_model import Link, Motion, ScannerLimits, Tuning
from steradian.plans.stages import MOST_STAGES, FocusStage, StoppingRule, check_stages, check_stopping
from steradian.plans.visit_order import visit_order
from steradian.plans.wavelength_bands import TunedOrder, hold_wavelength, order_by_bands

EXCITATION = (200e-9, 3e-6)
"""Excitation wavelengths of light that anybody excites with, in m."""


_LATER = (
    "wavelength_uncertainty",
    "max_sensitivity_loss",
    "fringe",
    "gate",
    "gate_rate",
    "beams",
    "stages",
    "stage_ends",
    "stopping",
)
"""Fields that plans were without: one that has them as they are by default is named as it was."""


class ScanPlan(DisplayableValue):
    """Scan plan: the instructions for a scanner to measure a mask; immutable and identified by its content."""

    mask: Mask
    pulse_rate: float = quantity_field("Hz", "Laser pulses per second", ge=0.1, le=10_000, default=50.0)
    averages: int = quantity_field("pulses", "Pulses averaged into one A-line", ge=1, le=65_535, default=1)
    samples: int = quantity_field("samples", "Samples of an A-line, N_t", ge=16, le=65_536, default=1024)
    sampling_interval: float = quantity_field("s", "Time between samples, dt", default=8e-9, **SAMPLING_INTERVAL.limits)
    sound_speed: float = quantity_field("m/s", "Assumed speed of sound", default=1500.0, **SOUND_SPEED.limits)
    order: VisitOrder = VisitOrder.SNAKE
    wavelengths: FloatArray | None = Field(
        default=None, description="(M,) best bias wavelength of each point of the mask (m); none: one for all"
    )
    wavelength_uncertainty: float = quantity_field(
        "m", "Standard deviation of these wavelengths", ge=0, le=1e-8, default=0.0
    )
    max_sensitivity_loss: float = quantity_field(
        "share", "Sensitivity a point may lose to save a retuning", ge=0, le=0.9, default=0.0
    )
    fringe: Fringe = Fringe()
    beams: tuple[tuple[float, float], ...] = Field(
        default=(),
        max_length=MOST_BEAMS,
        description="Where each interrogation beam is beside the first one, (0, 0), in m; none: one beam. The mask's"
        " points are those of the beams, place by place",
    )
    frames: int = quantity_field(
        "frames", "How often the mask is measured, at each excitation wavelength", ge=1, le=10_000, default=1
    )
    excitation: tuple[float, ...] = Field(
        default=(),
        max_length=64,
        description="Excitation wavelengths, measured one after the other (m); none: the laser's present one",
    )
    gate: Literal["none", "frame", "point"] = Field(
        default="none",
        description="Unit that waits for an edge at the scanner's gate input: a heart beat, a breath, a stimulus",
    )
    gate_rate: float = quantity_field("Hz", "Expected edges a second, for the preview", gt=0, le=10_000, default=1.0)
    stages: tuple[FocusStage, ...] = Field(
        default=(),
        max_length=MOST_STAGES,
        description="Further stages, whose points follow from the image of the points before; none: the mask is all",
    )
    stage_ends: tuple[int, ...] = Field(
        default=(), max_length=MOST_STAGES, description="Points of the mask at the end of each stage but the last"
    )
    stopping: StoppingRule | None = Field(default=None, description="Rule that ends the scan early; null: none")
    scanner: ScannerLimits = ScannerLimits()
    motion: Motion = Motion()
    tuning: Tuning = Tuning()
    link: Link = Link()

    @model_validator(mode="after")
    def _check(self) -> Self:
        record = self.samples * self.sampling_interval
        if record * self.pulse_rate >= 1:
            raise InvalidInput(
                "pulse_rate", f"{self.pulse_rate:g}", f"less than one pulse per record, {1 / record:g} Hz"
            )
        if self.wavelengths is not None and self.wavelengths.shape != (self.mask.count,):
            shape = self.wavelengths.shape
            raise InvalidInput("wavelengths", f"an array of shape {shape}", f"({self.mask.count},), one a point")
        if self.wavelengths is not None and (self.wavelengths <= 0).any():
            raise InvalidInput("wavelengths", f"{self.wavelengths.min():g}", "> 0 (m)")
        for place, value in enumerate(self.excitation):
            if not EXCITATION[0] <= value <= EXCITATION[1] or value in self.excitation[:place]:
                raise InvalidInput(f"excitation[{place}]", f"{value:g}", "200e-9 to 3e-6 (m), each once")
        if self.beams:
            self._check_beams()
        surveyed = self.mask.count if self.stages else max(self.stage_ends, default=0)
        check_stopping(self.stopping, self.order, self.frame_count, surveyed)
        check_stages(self.stages, is_line=self.mask.is_line, beams=self.beam_count)
        bounds = (0, *self.stage_ends, self.mask.count)
        if (np.diff(bounds) <= 0).any():
            raise InvalidInput("stage_ends", self.stage_ends, f"rising, from 1 to {self.mask.count - 1}")
        if self.order in (VisitOrder.WAVELENGTH, VisitOrder.BANDS) and self.wavelengths is None:
            raise InvalidInput("order", self.order, "another order, or give wavelengths (m) for the points")
        return self

    def _check_beams(self) -> None:
        pattern, points = check_beams(self.beams), self.mask.film_positions
        if len(points) % len(pattern) or not np.allclose(
            points.reshape(-1, len(pattern), 2) - self.beam_positions[:, None], pattern, rtol=0, atol=2 * NANOMETRE
        ):
            raise InvalidInput("mask", "points elsewhere", "the points of these beams, as multi_beam_mask() makes them")
        if self.order is VisitOrder.PROGRESSIVE and len(pattern) > 1:
            raise InvalidInput("order", self.order, "another order: several beams measure many points at a time")

    @cached_property
    def id(self) -> str:
        """Identifier of the content, ``p`` and 24 hexadecimal digits."""
        content = self.model_dump(mode="json", exclude={"mask"}) | {"mask": self.mask.id}
        if self.frames == 1:  # a plan of one frame is what it was before there were frames
            del content["frames"]
        if not self.excitation:
            del content["excitation"]
        for name in _LATER:
            if getattr(self, name) == type(self).model_fields[name].default:
                del content[name]
        return content_hash("p", content)

    @property
    def frame_count(self) -> int:
        """Number of frames F: sets of A-lines of the whole mask."""
        return self.frames * max(1, len(self.excitation))

    @property
    def frame_excitation(self) -> tuple[float, ...]:
        """Excitation wavelength of each frame (F,) in m, 0 if unchanged.

        All frames of one wavelength follow each other: tuning the laser takes longer than a frame.
        """
        return tuple(value for value in self.excitation or (0.0,) for _ in range(self.frames))

    @property
    def aline_count(self) -> int:
        """Number of A-lines of all frames, F·M."""
        return self.frame_count * self.mask.count

    @property
    def most_points(self) -> int:
        """Largest number of points of the mask after all stages."""
        return self.mask.count + sum(stage.points for stage in self.stages)

    @property
    def beam_count(self) -> int:
        """Number of interrogation beams B."""
        return max(1, len(self.beams))

    @property
    def beam_positions(self) -> NDArray[np.float64]:
        """Positions of the first beam (M/B, 2) in m: the mask's points if there is one beam."""
        return self.mask.film_positions[:: self.beam_count]

    @property
    def path(self) -> NDArray[np.float64]:
        """Positions (M/B, 2) in the order of interrogation, in m."""
        return self.mask.film_positions[self.visit[:: self.beam_count]]

    @cached_property
    def visit(self) -> NDArray[np.int64]:
        """Indices (M,) of the mask's positions in the order of interrogation; beams of a place in their order."""
        return self.tuned_order.visit

    @property
    def bias(self) -> NDArray[np.float64] | None:
        """Bias wavelength (M,) in m set at each point of the mask; ``None``: the scanner's default.

        It is the point's best one, or one near enough that was set before: as near as the tuning's tolerance says, or
        as :attr:`max_sensitivity_loss` allows.
        """
        return None if self.wavelengths is None else self.tuned_order.bias

    @cached_property
    def tuned_order(self) -> TunedOrder:
        """Order of interrogation together with the bias wavelengths."""
        if len(self.beams) > 1:
            return self._tuned_together()
        bounds = (0, *self.stage_ends, self.mask.count)
        parts = [self._tuned_stage(slice(*each)) for each in pairwise(bounds)]
        visit = np.concatenate([first + part.visit for first, part in zip(bounds, parts, strict=False)])
        return TunedOrder(visit, np.concatenate([part.bias for part in parts]))

    def _tuned_stage(self, part: slice) -> TunedOrder:
        """Return the order of one stage's points by themselves."""
        optima = None if self.wavelengths is None else self.wavelengths[part]
        return self._tuned(self.mask.film_positions[part], optima, self._mask_of(part))

    def _mask_of(self, part: slice) -> Mask:
        if not self.stage_ends:
            return self.mask
        return self.mask.replace(positions=self.mask.positions[part], weights=self.mask.weights[part], outline=None)

    def _tuned_together(self) -> TunedOrder:
        """Return the order for several beams, each place at the mean of its beams' optimum wavelengths."""
        count = self.beam_count
        optima = None if self.wavelengths is None else self.wavelengths.reshape(-1, count).mean(axis=1)
        found = self._tuned(self.beam_positions, optima, self.mask)
        return TunedOrder((found.visit[:, None] * count + np.arange(count)).ravel(), np.repeat(found.bias, count))

    def _tuned(self, points: NDArray[np.float64], optima: NDArray[np.float64] | None, mask: Mask) -> TunedOrder:
        if self.order is VisitOrder.BANDS and optima is not None:
            return order_by_bands(points, optima, self.fringe, self.max_sensitivity_loss, self.pace)
        step = self.tuning.tolerance
        visit = visit_order(points, self.order, mask=mask, wavelengths=optima, wavelength_step=step)
        bias = np.zeros(len(visit))
        if optima is not None:
            reach = (
                self.fringe.wavelength_tolerance(self.max_sensitivity_loss)
                if self.max_sensitivity_loss
                else (step, step)
            )
            bias[visit] = hold_wavelength(optima[visit], reach)
        return TunedOrder(visit, bias)

    @property
    def pace(self) -> MotionTiming:
        """Timing from each point to the next: motion, tuning, laser and link."""
        return MotionTiming(self.motion, self.tuning, self.pulse_rate, self.samples * self.sampling_interval)

    @property
    def recording_depth(self) -> float:
        """Maximum distance from a sensor covered by its A-line, in metres."""
        return (self.samples - 1) * self.sampling_interval * self.sound_speed

    @cached_property
    def pass_ends(self) -> tuple[int, ...]:
        """Number of points measured at the end of each stage and, in progressive order, of each pass."""
        bounds = (0, *self.stage_ends, self.mask.count)
        if self.order is not VisitOrder.PROGRESSIVE:
            return bounds[1:]
        masks = [(first, self._mask_of(slice(first, end))) for first, end in pairwise(bounds)]
        return tuple(first + end for first, mask in masks for end in progressive(mask.film_positions, mask).ends)

    def truncated_mask(self, points: int, weighting: Literal["analytic", "voronoi", "uniform"] = "analytic") -> Mask:
        """Return the mask of the first ``points`` visited points, with new weights.

        Parameters
        ----------
        points
            How many, at least 1; an end of :attr:`pass_ends` gives a mask that is even by itself.
        weighting
            ``analytic``: the whole mask's weights, scaled, right after whole passes; ``voronoi``: right anywhere.

        Raises
        ------
        InvalidInput
            When there are not so many points.
        """
        if not 1 <= points <= self.mask.count:
            raise InvalidInput("points", points, f"1 to {self.mask.count}")
        return subset_mask(self.mask, self.visit[:points].tolist(), weighting=weighting)

    def __repr__(self) -> str:
        frames = f" in {self.frame_count} frames" if self.frame_count > 1 else ""
        record = f"{self.samples} samples every {1e9 * self.sampling_interval:g} ns"
        order = str(self.order).replace("_", " ")
        beams = f" by {self.beam_count} beams" if self.beam_count > 1 else ""
        return (
            f"<ScanPlan: {self.mask.count:,} points{beams}{frames} at {self.pulse_rate:g} Hz, {record}, order {order}>"
        )
