"""Incremental reconstruction: A-lines are added to the lateral sum as they arrive.

The lateral transform (paper, NED-NUFFT, equation 6) is a sum over sensors, h_m · e^{−2πi j·x_m/X} · g[m, n], and
nothing before its end needs all of them. So that sum, per lateral mode j and time sample n, is kept, A-lines are added
to it as they come, and an image of the points so far costs the steps after it alone. Where new points change the share
of the aperture that an older one stands for, the difference of its weight is added.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.imaging.engines import ProgressMonitor
from steradian.imaging.plan import ReconstructionPlan
from steradian.imaging.volume import Volume

_NEIGHBOURS = 8
"""Sensors among which the area of a missing one is divided."""
MAX_WEIGHT_RATIO = 2.0
"""Most that a sensor stands for, in what it stood for if the plan were thinned out evenly."""
WEIGHT_CHANGE_THRESHOLD = 0.05
"""Relative change of a weight that is left for later."""


class IncrementalReconstruction:
    """Incremental reconstruction by a plan with A-lines that arrive one after another.

    Weights fitted to the sensors so far: each stands for its own area h of the whole plan; the area of a missing one is
    divided, in proportion to h, among those of its 8 nearest sensors of the plan that are measured; and none stands for
    more than twice what it would if all were thinned out evenly. So a half finished pass over the aperture is weighted
    evenly, and the edge of a region measured first does not stand for all of the rest. All are scaled to the sum of the
    plan's weights: a partial scan has the brightness of a whole one, and the last image the plan's own weights.

    Parameters
    ----------
    plan
        Of all sensors to come. Its method must not be "interpolated", where a sensor's share depends on its neighbours.
    fitted
        Whether weights are fitted; else they are the plan's own, scaled to the same sum.

    Attributes
    ----------
    plan
        As given.
    measured
        (M,) which sensors have been added.

    Raises
    ------
    InvalidInput
        If the plan's method is not a sum over sensors, sensors differ in sensitivity, or a GPU computes.
    """

    def __init__(self, plan: ReconstructionPlan, *, fitted: bool = True) -> None:
        if plan.chosen.device != "cpu":
            raise InvalidInput("device", plan.chosen.device, "cpu for an image that grows")
        if plan.acquisition.medium.lossy:
            raise InvalidInput(
                "medium", str(plan.acquisition.medium), "one without attenuation for an image that grows"
            )
        if plan.acquisition.sensitivity is not None:
            raise InvalidInput("sensitivity", "an array", "None for an image that grows: divide the A-lines")
        if plan.method == "interpolated":
            raise InvalidInput("method", plan.method, "nedner, ner, linear or nearest for an image that grows")
        self.plan = plan
        count = len(plan.geometry.positions)
        self.measured = np.zeros(count, bool)
        self._factors = np.zeros(count)  # of h, of each sensor's part of the sum
        self._neighbours = _neighbours(plan.geometry.positions) if fitted else None
        self._traces = np.zeros((count if fitted else 0, plan.tables.time.samples), plan.dtype)
        self._sum: Any = None  # modes over time, of the plan's engine

    @property
    def covered_fraction(self) -> float:
        """Fraction of the aperture covered so far: Σ h of the measured sensors over Σ h of all."""
        weights = self.plan.geometry.weights
        return float(weights[self.measured].sum() / weights.sum())

    @property
    def weights(self) -> NDArray[np.float64]:
        """Current weights of the sensors, (M,) in the plan's unit: 0 if not measured yet; the sum is the plan's."""
        weights = self.plan.geometry.weights
        fitted = weights * self._factors
        total = float(fitted.sum())
        return fitted * (float(weights.sum()) / total) if total else fitted

    def add(
        self,
        sensors: ArrayLike,
        traces: ArrayLike,
        *,
        progress: Progress | None = None,
        cancelled: CancelCheck | None = None,
    ) -> None:
        """Add the A-lines of newly measured sensors to the lateral sum.

        Parameters
        ----------
        sensors
            (K,) numbers of the plan's sensors, each for the first time.
        traces
            (K, N_t) their A-lines, in the unit wanted of the image.
        progress, cancelled
            See :mod:`steradian.core.progress`. After ``Cancelled`` the sum is only good for :meth:`clear`.

        Raises
        ------
        InvalidInput
            If a number is unknown or was added before, a sample is not finite or the shape does not fit; the sum is
            then as before.
        Cancelled
            If ``cancelled`` said so.
        """
        which, data = self._checked(sensors, traces)
        if not len(which):
            return
        self.measured[which] = True
        difference = self._wanted() - self._factors
        if self._neighbours is not None:
            self._traces[which] = data
            least = 0.0 if self.measured.all() else WEIGHT_CHANGE_THRESHOLD * self._factors
            which = np.flatnonzero(np.abs(difference) > least)
            data = self._traces[which]
        data = data * difference[which, None].astype(data.dtype)
        self._sum = self.plan.engine.lateral(data, ProgressMonitor(progress, cancelled), sensors=which, onto=self._sum)
        self._factors[which] += difference[which]

    def clear(self) -> None:
        """Delete all A-lines: reset the lateral sum to zero."""
        self._sum = None
        self._factors[:] = 0
        self.measured[:] = False

    def volume(self, *, progress: Progress | None = None, cancelled: CancelCheck | None = None) -> Volume:
        """Return the image of the sensors measured so far; the lateral sum is unchanged.

        Returns
        -------
        Volume
            What a plan made for these sensors with these :attr:`weights` gives of their A-lines.

        Raises
        ------
        InvalidInput
            If there is no sensor yet, or their weights sum to 0.
        Cancelled
            If ``cancelled`` said so.
        """
        weights = self.plan.geometry.weights
        part_of_sum = float((weights * self._factors).sum() / weights.sum())
        if part_of_sum == 0:
            raise InvalidInput("sensors", "none with a weight", "at least one A-line added before")
        plan, watch = self.plan, ProgressMonitor(progress, cancelled)
        images = []
        for number, layer in enumerate(plan.layers, start=1):
            part = watch.of_layer(number, len(plan.layers)) if len(plan.layers) > 1 else watch
            engine: Any = layer.chosen.engine
            modes, room = self._sum, plan.engine.room
            if number > 1:  # of the same sensors and times, in rows of another length
                modes = engine.room.relaid(modes, room, plan.tables.time.samples)
            images.append(engine.to_image(engine.to_depth(modes, part, kept=True), part))
        values = images[0] if len(images) == 1 else np.concatenate(images, axis=-1)
        values *= values.dtype.type(1.0 / part_of_sum)
        return plan.as_volume(values)

    def _wanted(self) -> NDArray[np.float64]:
        """Return weight factors (M,) that distribute the area of missing sensors to their neighbours."""
        found = self.measured.astype(np.float64)
        if self._neighbours is not None:
            weights = self.plan.geometry.weights
            near = self._neighbours[~self.measured]
            heirs = np.where(self.measured[near], weights[near], 0.0)
            total = heirs.sum(axis=1)
            shared = total > 0
            rate = weights[~self.measured][shared] / total[shared]  # of area inherited to area owned
            found += np.bincount(near[shared].ravel(), (rate[:, None] * (heirs[shared] > 0)).ravel(), len(found))
            found[~self.measured] = 0.0
            measured = float(weights[self.measured].sum())
            if measured > 0:
                np.minimum(found, max(1.0, MAX_WEIGHT_RATIO * float(weights.sum()) / measured), out=found)
        return found

    def _checked(self, sensors: ArrayLike, traces: ArrayLike) -> tuple[NDArray[np.int64], NDArray[Any]]:
        which, data = np.asarray(sensors), np.asarray(traces)
        count, samples = len(self.measured), self.plan.geometry.samples
        if which.ndim != 1 or (len(which) and which.dtype.kind not in "iu"):
            raise InvalidInput("sensors", f"an array of {which.dtype}, {which.ndim} axes", "one whole number an A-line")
        which = which.astype(np.int64)
        if len(which) and not (0 <= which.min() and which.max() < count):
            raise InvalidInput("sensors", f"{which.min()} to {which.max()}", f"0 to {count - 1}")
        if self.measured[which].any() or len(np.unique(which)) != len(which):
            raise InvalidInput("sensors", "a sensor for the second time", "each sensor once")
        if data.shape != (len(which), samples):
            raise InvalidInput("traces", f"an array of shape {data.shape}", f"shape ({len(which)}, {samples})")
        data = data.astype(self.plan.dtype, copy=False)
        if not np.isfinite(data).all():
            raise InvalidInput("traces", "a sample that is not finite", "finite numbers")
        return which, self.plan.decimate(data)


def _neighbours(positions: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the indices of each sensor's 8 nearest sensors and itself, (M, 9), or of all if fewer."""
    from scipy.spatial import KDTree

    count = min(_NEIGHBOURS + 1, len(positions))
    found = np.asarray(KDTree(positions).query(positions, count)[1], np.int64)
    return found.reshape(len(positions), count)
