"""Search for the parameters of a medium: speeds and thicknesses of layers, and time zero.

For sensors on a plane the parameters are those of the least misfit (:mod:`.medium_fit`). For sensors on a line, and
records too long for the forward model, they are found by focus, layer by layer (:mod:`.medium_focus`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from steradian.core.exceptions import InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.imaging import Acquisition, Medium
from steradian.imaging import validation as checks
from steradian.imaging.engines.array_namespace import to_numpy
from steradian.imaging.geometry.depth_extent import Extent
from steradian.imaging.geometry.sensor_sensitivity import check_sensitivity
from steradian.reconstructions.studies.boundary_echoes import PlaneEchoes
from steradian.reconstructions.studies.medium_fit import MediumFit, most_steps
from steradian.reconstructions.studies.medium_focus import GROUPS, STEPS, Focused, LayerFocus
from steradian.reconstructions.studies.medium_unknowns import MediumState, Unknown, resolve_unknowns
from steradian.reconstructions.studies.sound_speed_images import Views

BY_FOCUS = (
    "found by the sharpest image of each layer; the error has the difference of two criteria, not what biases both"
)
TRADE = 0.8
"""Correlation from which on a note states that two parameters trade against each other."""
UNDETERMINED = 0.5
"""Standard error, relative to the half-width of the range, from which on a parameter counts as not determined."""


@dataclass(frozen=True)
class FoundParameter:
    """Parameter of a medium that a search found.

    Parameters
    ----------
    name, unit
        ``layer1.sound_speed`` in m/s, ``layer1.thickness`` in m or ``time_zero`` in s.
    start, value, standard_error
        Start of the search, what was found, and its standard error (68 %); None: not asked for.
    low, high, at_edge
        Range searched, and whether the value is at its end.
    criterion
        "misfit", "sharpness" or "boundary echo".
    values, criterion_values
        Values tried, the other parameters held, and there the relative misfit, sharpness or amplitude of echoes.
    """

    name: str
    unit: str
    start: float
    value: float
    standard_error: float | None
    low: float
    high: float
    at_edge: bool
    criterion: str
    values: tuple[float, ...] = ()
    criterion_values: tuple[float, ...] = ()


@dataclass(frozen=True)
class FoundMedium:
    """Result of a search for the parameters of a medium.

    Parameters
    ----------
    parameters
        Those searched for, in the order asked for.
    medium
        Layers with the values found.
    time_zero
        Time of the first sample after the pulse in s, with the value found.
    correlations
        (P, P) of the errors.
    notes
        What was assumed, and which parameters trade against each other or are not determined.
    """

    parameters: tuple[FoundParameter, ...]
    medium: Medium
    time_zero: float
    correlations: tuple[tuple[float, ...], ...]
    notes: tuple[str, ...] = ()


def find_medium(
    acquisition: Acquisition,
    search: Sequence[str] | None = None,
    *,
    span: float = 0.1,
    modes: int | None = None,
    depth: tuple[float, float] | None = None,
    standard_error: bool = True,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> FoundMedium:
    """Estimate speeds and thicknesses of layers, and time zero, from A-lines in memory.

    Parameters
    ----------
    acquisition
        A-lines with sensors and timing; ``medium`` and ``t0`` are the start, and kept where they are not searched for.
    search
        Names of the parameters: ``layer1.sound_speed`` (layer 1 is at the film), ``layer1.thickness``, ``time_zero``.
        None: the speeds of all layers.
    span
        Half-width of the range searched, relative to each start value; of time zero, relative to the time of flight in
        the middle of the record.
    modes
        Most lateral modes of images whose sharpness counts; None: one each 120 µm.
    depth
        First and last depth in m, at the start; None: all of the record.
    standard_error
        Give standard errors; without, the search by focus takes a fifth of the time.
    progress, cancelled
        Reported and asked after each image or iteration.

    Raises
    ------
    InvalidInput
        When a name or a number is out of range.
    Cancelled
        When ``cancelled`` said so.
    """
    traces, interval, zero = to_numpy(acquisition.traces), acquisition.dt, acquisition.t0
    if acquisition.sensitivity is not None:
        traces = traces / check_sensitivity(acquisition.sensitivity, len(traces))[:, None]
    sensors, weights, sides = checks.resolve_sensors(acquisition.sensors, acquisition.weights, acquisition.aperture)
    positions = checks.check_positions(sensors)
    line = positions.shape[1] == 1
    aperture = max(checks.apertures(sides, positions.shape[1]))
    positions = positions[:, 0] if line else positions
    start = MediumState(acquisition.medium, zero)
    extent = Extent.of(traces.shape[1], interval, zero)
    times = (extent.first * interval, (extent.end - 1) * interval)
    depth_times = depth and (acquisition.medium.time_at(depth[0]), acquisition.medium.time_at(depth[1]))
    if depth_times is not None:
        times = (max(times[0], depth_times[0]), min(times[1], depth_times[1]))
    unknowns = resolve_unknowns(search, start, span=span, middle=sum(times) / 2)
    echoes = PlaneEchoes(traces, interval, zero) if line and len(start.medium.layers) > 1 else None
    data = traces if echoes is None else np.asarray(traces, np.float32) - echoes.median.astype(np.float32)
    views = Views(data, positions, interval, aperture, modes, weights, depth_times, zero, all_frequencies=True)
    notes: tuple[str, ...] = ()
    if not line:
        views.report(progress, cancelled, most_steps(len(unknowns)))
        try:
            fit = MediumFit(traces, positions, interval, aperture, start, unknowns, depth_times, views.tell)
        except InvalidInput as refusal:
            notes = (f"({refusal})",)
        else:
            state = fit.find(start)
            views.finish()
            found = [Focused(unknowns, state.values, state.covariance, True, "misfit", state.curves)]
            return _result(start, unknowns, found, (), standard_error)
    images = sum(STEPS[1] for _ in unknowns) * (1 + GROUPS // 2)
    views.report(progress, cancelled, images)
    focus = LayerFocus(views, echoes, unknowns, times, len(positions), standard_error)
    found = focus.find(start)
    views.finish()
    if any(each.criterion == "sharpness" for each in found):
        names = ", ".join(u.name for each in found if each.criterion == "sharpness" for u in each.unknowns)
        notes = (" ".join((f"{names}: {BY_FOCUS}", *notes)),)
    return _result(start, unknowns, found, (*(each.note for each in found if each.note), *notes), standard_error)


def _result(
    start: MediumState, unknowns: Sequence[Unknown], found: Sequence[Focused], notes: tuple[str, ...], errors: bool
) -> FoundMedium:
    """Return the parameters found in the order asked for, with notes on trades."""
    order = [each for one in found for each in one.unknowns]
    covariance = np.zeros((len(order), len(order)))
    curves, criteria, inside, values, at = {}, {}, {}, {}, 0
    for one in found:
        count = len(one.unknowns)
        covariance[at : at + count, at : at + count] = one.covariance
        at += count
        for i, each in enumerate(one.unknowns):
            curves[each], criteria[each], inside[each] = one.curves[i], one.criterion, one.determined
            values[each] = float(one.values[i])
    which = [order.index(each) for each in unknowns]
    covariance = covariance[np.ix_(which, which)]
    deviations = np.sqrt(np.diag(covariance))
    correlations = covariance / np.outer(deviations, deviations) if (deviations > 0).all() else np.eye(len(unknowns))
    parameters = []
    for each, deviation in zip(unknowns, deviations, strict=True):
        value = values[each]
        edge = not each.low < value < each.high
        parameters.append(
            FoundParameter(
                each.name, each.unit, start.value(each), value, float(deviation) if errors else None, each.low,
                each.high, edge, criteria[each], *curves[each],
            )
        )  # fmt: skip
        share = float(deviation) / (0.5 * (each.high - each.low))
        if edge:
            notes = (*notes, f"{each.name} is at the end of the range searched")
        elif not inside[each]:
            notes = (*notes, f"{each.name} is not determined by this record: the criterion has no maximum in the range")
        elif errors and share > UNDETERMINED:
            text = f"its error is {share:.2g} times the half-width of the range"
            notes = (*notes, f"{each.name} is not determined by this record: {text}")
    for (i, first), (j, second) in combinations(enumerate(unknowns), 2):
        if errors and abs(correlations[i, j]) >= TRADE:
            same = "the same" if correlations[i, j] > 0 else "the other"
            text = f"{first.name} and {second.name} trade against each other: an error of one goes with an error of"
            notes = (*notes, f"{text} the other in {same} direction (correlation {correlations[i, j]:+.2f})")
    state = start.with_values(values)
    rows = tuple(tuple(map(float, row)) for row in correlations)
    return FoundMedium(tuple(parameters), state.medium, state.time_zero, rows, notes)
