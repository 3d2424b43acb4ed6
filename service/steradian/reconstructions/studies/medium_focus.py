"""Medium by focus, layer by layer: sharpest image of each layer, and plane echoes of the boundaries.

The image of a layer depends on that layer and on those above. From the film downwards, each layer's own speed, the
thickness of the layer above and, in the first, time zero are those of the sharpest image of the layer. The criterion is
the kurtosis of the envelope along the film; what its gradients give differs, and the difference is part of the error.
Where a boundary has a clear plane echo, its arrival gives the ratio of thickness and speed of the layer above it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.imaging import Medium
from steradian.reconstructions.studies.boundary_echoes import PlaneEcho, PlaneEchoes
from steradian.reconstructions.studies.medium_unknowns import MediumState, Unknown
from steradian.reconstructions.studies.sound_speed_images import Views

GROUPS = 6
"""Groups of sensors, one left out at a time for the covariance (jackknife)."""
STEPS, ECHO_STEPS = {1: 21, 2: 11}, 201
"""Values tried of each parameter, by how many are sought at once; and values of the curve of an echo."""

Floats = NDArray[np.float64]
Curve = tuple[tuple[float, ...], tuple[float, ...]]


@dataclass(frozen=True)
class Focused:
    """Parameters found together.

    Parameters
    ----------
    unknowns, values, covariance
        P parameters with their values, and (P, P) covariance, in SI units.
    determined
        False where the criterion has no maximum within the range.
    criterion
        "sharpness" or "boundary echo".
    curves
        For each, values tried, the others held, and sharpness or the echoes' amplitude there.
    note
        Text on an echo; "" without.
    """

    unknowns: tuple[Unknown, ...]
    values: Floats
    covariance: Floats
    determined: bool
    criterion: str
    curves: tuple[Curve, ...]
    note: str = ""


class LayerFocus:
    """Search for the parameters of a medium from the film downwards.

    Parameters
    ----------
    views, echoes
        Images of the recording, and its plane echoes; None: not searched for.
    unknowns
        Parameters that are varied.
    times
        First and last time of flight in s of the images.
    sensors
        Number of sensors.
    standard_error
        Leave groups of sensors out for the covariance.
    """

    def __init__(
        self,
        views: Views,
        echoes: PlaneEchoes | None,
        unknowns: Sequence[Unknown],
        times: tuple[float, float],
        sensors: int,
        standard_error: bool,
    ) -> None:
        self._views, self._echoes, self._times = views, echoes, times
        self._left = list(unknowns)
        self._errors: dict[Unknown, float] = {}
        self._zero = 0.0
        self._jackknife = standard_error and sensors >= 4 * GROUPS
        self._member = np.random.default_rng(0).permutation(sensors) % GROUPS

    def find(self, start: MediumState) -> list[Focused]:
        """Return the parameters found, in the order of the layers."""
        found: list[Focused] = []
        state, above, self._zero = start, PlaneEcho(0.0, 0.0), start.time_zero
        for index, layer in enumerate(start.medium.layers):
            last = index + 1 == len(start.medium.layers)
            echo = None if last else self._echo(state, index)
            own = [each for each in self._left if each.layer == index]
            zero = [each for each in self._left if each.layer is None]
            above_left = [each for each in self._left if each.layer == index - 1]  # a thickness without an echo
            by_echo: Focused | None = None
            if echo and len(own) == 1 and not above_left and not (index == 0 and zero):
                by_echo = self._from_echo(own[0], state, echo, above)
            elif echo and not own and index == 0 and zero:
                by_echo = self._zero_from_echo(zero[0], state, echo, layer.thickness or 0.0)
            if by_echo is None:
                together = [*(each for each in own if each.quantity == "sound_speed"), *(zero if index == 0 else [])]
                together += above_left
                if together:
                    state, found = self._settled(state, found, self._focus(state, index, together))
                    thickness = [each for each in own if each.quantity == "thickness"]
                    if echo and thickness and not zero:
                        by_echo = self._from_echo(thickness[0], state, echo, above)
            if by_echo is not None:
                state, found = self._settled(state, found, by_echo)
            if not last:
                expected = state.medium.time_at(state.medium.boundaries[index])
                above = echo or PlaneEcho(*(2 * [expected + self._zero - state.time_zero]))
        return found

    def _settled(self, state: MediumState, found: list[Focused], new: Focused) -> tuple[MediumState, list[Focused]]:
        self._left = [each for each in self._left if each not in new.unknowns]
        values = {each: float(value) for each, value in zip(new.unknowns, new.values, strict=True)}
        self._errors |= dict(zip(new.unknowns, np.sqrt(np.diag(new.covariance)), strict=True))
        return state.with_values(values), [*found, new]

    def _echo(self, state: MediumState, index: int) -> PlaneEcho | None:
        """Return the echo of a layer's lower boundary in the ranges of the parameters, in times of the start."""
        if self._echoes is None:
            return None
        own = [each for each in self._left if each.layer == index]
        slow, fast = (
            state.with_values({
                each: each.low if (each.quantity == "sound_speed") is late else each.high for each in own
            })
            for late in (True, False)
        )  # fmt: skip
        first, last = (each.medium.time_at(each.medium.boundaries[index]) for each in (fast, slow))
        margin, zeros = 0.02 * last, [each for each in self._left if each.layer is None]
        early, late = (zeros[0].high, zeros[0].low) if zeros else 2 * (state.time_zero,)
        return self._echoes.between(first - margin + self._zero - early, last + margin + self._zero - late)

    def _from_echo(self, unknown: Unknown, state: MediumState, echo: PlaneEcho, above: PlaneEcho) -> Focused:
        """Return a layer's speed or thickness from the echoes of its boundaries."""
        index = unknown.layer or 0
        layer = state.medium.layers[index]
        time, other = echo.rise - above.rise, echo.peak - above.peak
        error = abs(time - other) / time
        tried = np.linspace(unknown.low, unknown.high, ECHO_STEPS)
        if unknown.quantity == "sound_speed":
            thickness = layer.thickness or 0.0
            arrivals, value = above.rise + thickness / tried, thickness / time
            return self._of_echo(unknown, (value, error * value), echo, (tried, arrivals), index + 1)
        arrivals, value = above.rise + tried / layer.sound_speed, layer.sound_speed * time
        speeds = [e for each, e in self._errors.items() if each.layer == index and each.quantity == "sound_speed"]
        trade = f"; it trades against the speed of layer {index + 1}, in proportion" if speeds else ""
        error = float(np.linalg.norm([error, *(each / layer.sound_speed for each in speeds)]))
        return self._of_echo(unknown, (value, error * value), echo, (tried, arrivals), index + 1, trade)

    def _zero_from_echo(self, unknown: Unknown, state: MediumState, echo: PlaneEcho, thickness: float) -> Focused:
        """Return time zero from the echo of the first boundary, whose layer is known."""
        expected = thickness / state.medium.layers[0].sound_speed
        value, tried = state.time_zero + expected - echo.rise, np.linspace(unknown.low, unknown.high, ECHO_STEPS)
        arrivals = expected + state.time_zero - tried  # on the time axis of the start
        return self._of_echo(unknown, (value, echo.peak - echo.rise), echo, (tried, arrivals), 1)

    def _of_echo(
        self,
        unknown: Unknown,
        result: tuple[float, float],
        echo: PlaneEcho,
        tried: tuple[Floats, Floats],
        boundary: int,
        more: str = "",
    ) -> Focused:
        """Return a parameter, with its error, found by the echo of a boundary; ``tried`` are values and arrivals."""
        value, error = result
        note = (
            f"{unknown.name} is from the plane echo at {1e6 * echo.rise:.2f} µs, taken for that of boundary {boundary}"
        )
        heights = np.zeros(ECHO_STEPS) if self._echoes is None else self._echoes.amplitude(tried[1])
        curve = (tuple(map(float, tried[0])), tuple(map(float, heights)))
        inside, covariance = unknown.low < value < unknown.high, np.array([[error**2]])
        return Focused((unknown,), np.array([value]), covariance, inside, "boundary echo", (curve,), note + more)

    def _focus(self, state: MediumState, index: int, together: Sequence[Unknown]) -> Focused:
        """Return the parameters at which the image of a layer is sharpest."""
        times = self._window(state.medium, index)
        if times[1] <= times[0]:
            allowed = f"parameters of layers that the record tells of, up to {1e6 * self._times[1]:.4g} µs"
            raise InvalidInput("search", ", ".join(each.name for each in together), allowed)

        def sharpness(values: Sequence[float], some: NDArray[np.bool_] | None = None) -> tuple[float, float]:
            moved = state.with_values(dict(zip(together, values, strict=True)))
            path = moved.medium.layer_paths()[index]
            return self._views.lateral_sharpness(path.medium, moved.time_zero, times, some)

        lines = [np.linspace(each.low, each.high, STEPS[len(together)]) for each in together]
        points = np.array(list(product(*lines)))
        heights, gradients = np.array([sharpness(point) for point in points]).T
        top = points[heights.argmax()]
        reach = np.array([0.5 * (each.high - each.low) for each in together])
        near = (np.abs(points - top) <= 0.5 * reach * (1 + 1e-9)).all(axis=1)
        best, inside = _summit(points[near], heights[near], reach)
        inside &= all(low < value < high for value, low, high in zip(best, *_ends(together), strict=True))
        covariance = np.diag(reach**2)
        if inside and self._jackknife:
            left_out = [[sharpness(p, self._member != group)[0] for p in points[near]] for group in range(GROUPS)]
            others = np.array([_summit(points[near], np.array(each), reach)[0] for each in left_out])
            spread = others - others.mean(axis=0)
            # another criterion of sharpness has another bias
            shift = _summit(points[near], gradients[near], reach)[0] - best
            covariance = (GROUPS - 1) / GROUPS * spread.T @ spread + np.outer(shift, shift)
        curves = []
        for i, line in enumerate(lines):
            held = np.isclose(np.delete(points, i, axis=1), np.delete(top, i)).all(axis=1)
            curves.append((tuple(map(float, line)), tuple(map(float, heights[held]))))
        return Focused(tuple(together), best, covariance, inside, "sharpness", tuple(curves))

    def _window(self, medium: Medium, index: int) -> tuple[float, float]:
        """Return the times of flight of a layer's image."""
        first = medium.time_at(medium.boundaries[index - 1]) if index else 0.0
        bounds = (*medium.boundaries, np.inf)
        last = self._times[1] if np.isinf(bounds[index]) else min(self._times[1], medium.time_at(bounds[index]))
        return max(self._times[0], first), last


def _ends(unknowns: Sequence[Unknown]) -> tuple[list[float], list[float]]:
    return [each.low for each in unknowns], [each.high for each in unknowns]


def _summit(points: Floats, heights: Floats, reach: Floats) -> tuple[Floats, bool]:
    """Return the maximum of a least-squares quadratic within the points, and whether there is one.

    Parameters
    ----------
    points, heights
        (K, P) values, and (K,) sharpness there.
    reach
        (P,) scale of each parameter.
    """
    middle = points.mean(axis=0)
    u = (points - middle) / reach
    count = u.shape[1]
    pairs = [(i, j) for i in range(count) for j in range(i, count)]
    design = np.column_stack([np.ones(len(u)), u, *(u[:, i] * u[:, j] for i, j in pairs)])
    found: Any = np.linalg.lstsq(design, heights, rcond=None)[0]
    hessian = np.zeros((count, count))
    for (i, j), value in zip(pairs, found[1 + count :], strict=True):
        hessian[i, j] += value
        hessian[j, i] += value
    low, high = points.min(axis=0), points.max(axis=0)
    if not (np.linalg.eigvalsh(hessian) < 0).all():
        return points[int(heights.argmax())], False
    return np.clip(middle - reach * np.linalg.solve(hessian, found[1 : 1 + count]), low, high), True
