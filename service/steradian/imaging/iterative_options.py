"""Options of iterative reconstruction: regularisation, stopping rules and the model's tolerance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal, TypeAlias, get_args

import numpy as np

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import TOLERANCE
from steradian.imaging.film_response import MAX_GAIN, InverseFilter
from steradian.imaging.options import check_correction

Regularisation: TypeAlias = Literal["thresholding", "total-variation", "sparsity", "tikhonov", "none"]


@dataclass(frozen=True, slots=True)
class IterativeOptions:
    """Options of the iterative method: regularisation and stopping rules.

    Parameters
    ----------
    regularisation
        "thresholding" (:mod:`.iterative.ista`), several times faster than the others and nearer to objects that leave
        most voxels empty; "total-variation", a little nearer to smooth ones that fill the volume; "sparsity" (sum of
        absolute values), "tikhonov" (½ sum of squares) or "none".
    strength
        λ as a share of the largest value of Aᵀg (above which sparsity would leave nothing); for tikhonov of A's largest
        singular value squared; for thresholding in standard deviations of a step's streaks. None: 0.01 for total
        variation, 0.02 for sparsity, 0.1 for tikhonov, 4.5 for thresholding.
    non_negative
        Look among images without negative values only.
    iterations
        Most iterations.
    change
        Stop when an iteration changes the image by less than this share of its norm.
    discrepancy
        Stop when the residual is below so many times the noise's norm (Morozov's principle), of thresholding from many
        sensors not before the fourth iteration; None: do not look.
    noise
        Standard deviation of the noise of one sample, in the traces' unit; None: read from above the signal's band.
    highest_frequency
        End of the band in Hz; None: read from the traces.
    refits
        Most steps at the end, of thresholding only, that fit the voxels found without thresholds, as long as more than
        noise is left of the misfit.
    """

    regularisation: Regularisation = "thresholding"
    strength: float | None = None
    non_negative: bool = True
    iterations: int = 30
    change: float = 1e-3
    discrepancy: float | None = 1.0
    noise: float | None = None
    highest_frequency: float | None = None
    refits: int = 1

    def __post_init__(self) -> None:
        if self.regularisation not in get_args(Regularisation):
            raise InvalidInput("regularisation", self.regularisation, ", ".join(get_args(Regularisation)))
        for name, most in (("strength", 1e6), ("discrepancy", 1e6), ("noise", np.inf), ("highest_frequency", np.inf)):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and 0 <= value <= most):
                up_to = "" if most == np.inf else f" to {most:g}"
                raise InvalidInput(name, value, f"a finite number from 0{up_to}, or None")
        if self.highest_frequency == 0:
            raise InvalidInput("highest_frequency", 0, "above 0 Hz, or None")
        if self.iterations != int(self.iterations) or not 1 <= self.iterations <= 10_000:
            raise InvalidInput("iterations", self.iterations, "a whole number from 1 to 10000")
        if self.refits != int(self.refits) or not 0 <= self.refits <= 100:
            raise InvalidInput("refits", self.refits, "a whole number from 0 to 100")
        if not 0 <= self.change < 1:
            raise InvalidInput("change", self.change, "a share from 0, below 1")

    def lambda_(self) -> float:
        """Return the regularisation parameter λ in the units described under ``strength``."""
        if self.strength is not None:
            return float(self.strength)
        return {"total-variation": 0.01, "sparsity": 0.02, "tikhonov": 0.1, "none": 0.0, "thresholding": 4.5}[
            self.regularisation
        ]


@dataclass(frozen=True, slots=True)
class Iterative(IterativeOptions):
    """Iterative reconstruction method: regularised fit of the image to the A-lines.

    Weights play no part. Sound from outside ``ImageGrid.depth`` is not in the model, so the range must contain all
    sources. Algorithm: :mod:`steradian.imaging.iterative.solve`.

    Parameters
    ----------
    regularisation, strength, non_negative, iterations, change, discrepancy, noise, highest_frequency, refits
        As in :class:`IterativeOptions`.
    tolerance
        Relative error of the forward model against its direct sums.
    correction
        The film's response, which the model contains; ``max_gain`` plays no part and must be the default. None: an
        ideal sensor.

    Raises
    ------
    InvalidInput
        If a value is out of range.
    """

    name: ClassVar[str] = "iterative"
    """Name of the method in reports, files and the HTTP API."""

    tolerance: float = 1e-4
    correction: InverseFilter | None = None

    def __post_init__(self) -> None:
        IterativeOptions.__post_init__(self)
        object.__setattr__(self, "tolerance", TOLERANCE.check("tolerance", self.tolerance))
        check_correction(self.correction)
        if self.correction is not None and self.correction.max_gain != MAX_GAIN:
            allowed = f"{MAX_GAIN:g} with the method iterative, which uses no other"
            raise InvalidInput("correction.max_gain", self.correction.max_gain, allowed)
