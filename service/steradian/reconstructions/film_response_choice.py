"""Selection of the Fabry–Pérot film response that a reconstruction corrects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from steradian.core.quantity_ranges import GAIN, SPOT
from steradian.core.validation import Value, quantity_field
from steradian.imaging.film_response import ElasticFilm, FilmResponse, InverseFilter
from steradian.imaging.sensing_spot import SensingSpot, SpotProfile
from steradian.masks.film_attenuation import HIGHEST, REFERENCE_ANGLE, REFERENCE_SLOPE


class Spot(Value):
    """Sensing spot of the interrogation beam, over which it averages the pressure."""

    diameter: float | None = quantity_field(
        "m", "Diameter, of a Gaussian beam at 1/e²; none: a point", default=None, **SPOT.limits
    )
    profile: SpotProfile = Field(default="gaussian", description="Profile of the intensity")


class Film(Value):
    """Film response over frequency and angle that a reconstruction corrects; parameter of requests."""

    kind: Literal["ideal", "elastic", "rule", "simulated"] = Field(
        default="ideal",
        description="ideal: no correction; elastic: an elastic film on an elastic backing (Cox and Beard 2007); "
        "rule: the loss at an angle by the paper's two figures, as in what a mask promises; "
        "simulated: what the film of the simulated scanner took away, as the scan says, nothing where it was ideal",
    )
    max_gain: float = quantity_field(
        "times", "Largest amplification of a wave, and of the noise", **GAIN.limits, default=10
    )
    thickness: float = quantity_field("m", "Distance of the mirrors", gt=0, le=1e-3, default=38e-6)
    speeds: tuple[float, float] = Field(
        default=(2200.0, 1100.0), description="Longitudinal and shear speed in the film (m/s)"
    )
    density: float = quantity_field("kg/m³", "Of the film", gt=0, le=30e3, default=1289.0)
    backing_speeds: tuple[float, float] = Field(
        default=(2180.0, 910.0), description="Longitudinal and shear speed in the backing (m/s)"
    )
    backing_density: float = quantity_field("kg/m³", "Of the backing", gt=0, le=30e3, default=1200.0)
    spot: Spot = Field(default=Spot(), description="Sensing spot, corrected for with every kind of film")

    def correction(self, recorded: str = "") -> InverseFilter | None:
        """Return the correction of film and sensing spot; None for a point on an ideal film.

        Parameters
        ----------
        recorded
            The simulated film's response as a scan states it, "ideal" or "bandwidth, directivity"; "": it does not.

        Raises
        ------
        InvalidInput
            When a pair of speeds is impossible.
        """
        response = self._response(recorded)
        if self.spot.diameter is not None:
            response = SensingSpot(self.spot.diameter, self.spot.profile, response)
        return None if response is None else InverseFilter(response, self.max_gain)

    def _response(self, recorded: str) -> FilmResponse | None:
        match self.kind:
            case "ideal":
                return None
            case "rule":
                return EmpiricalFilmResponse()
            case "simulated":
                lost = [part for part in SIMULATED if not recorded or part in recorded]
                return SimulatedFilmResponse("bandwidth" in lost, "directivity" in lost) if lost else None
            case "elastic":
                return ElasticFilm(
                    thickness=self.thickness,
                    speeds=self.speeds,
                    density=self.density,
                    backing_speeds=self.backing_speeds,
                    backing_density=self.backing_density,
                )

    def notes(self, recorded: str = "") -> tuple[str, ...]:
        """Return notes where this correction does not match the film ``recorded`` in the scan."""
        lost = [part for part in SIMULATED if part in recorded]
        match self.kind:
            case "simulated" if not recorded:
                return (
                    "the scan does not state its film's response; corrected as for a simulated film with all of it",
                )
            case "simulated" if not lost:
                corrected = "nothing" if self.spot.diameter is None else "nothing but the spot"
                return (f"the scan's film was {recorded}: {corrected} was corrected",)
            case "elastic" | "rule" if recorded and not lost:
                return (f"the scan's film was {recorded}: the correction amplifies what was not lost",)
            case "ideal" if lost:
                return (f"the scan's film has a response ({recorded}) that was not corrected: --film simulated does",)
        return ()


class EmpiricalFilmResponse:
    """Film response by the empirical attenuation rule, constant above the rule's frequency range."""

    def evaluate(
        self, frequencies: NDArray[np.float64], sines: NDArray[np.float64], sound_speed: float
    ) -> NDArray[np.complex128]:
        """Return the complex response at frequencies and sines of the angle of incidence."""
        known = np.minimum(np.asarray(frequencies, np.float64), HIGHEST)[:, None]
        across = (np.asarray(sines, np.float64)[None, :] / np.sin(REFERENCE_ANGLE)) ** 2
        return np.asarray(10 ** (-REFERENCE_SLOPE * known * across / 20), np.complex128)


SIMULATED = ("bandwidth", "directivity")
"""What a simulated film may take away and :class:`SimulatedFilmResponse` gives back."""


@dataclass(frozen=True)
class SimulatedFilmResponse:
    """Film response of the simulated scanner: a one-pole low-pass in frequency and a loss at oblique angles."""

    bandwidth: bool = True
    directivity: bool = True

    def evaluate(
        self, frequencies: NDArray[np.float64], sines: NDArray[np.float64], sound_speed: float
    ) -> NDArray[np.complex128]:
        """Return the complex response at frequencies and sines of the angle of incidence."""
        from fabry_perot.simulator.film import BANDWIDTH, directivity

        sines, frequencies = np.asarray(sines, np.float64), np.asarray(frequencies, np.float64)
        across = directivity(np.sqrt(1 - np.clip(sines, 0, 1) ** 2)) if self.directivity else np.ones_like(sines)
        pole = 1 + 1j * frequencies / BANDWIDTH if self.bandwidth else np.ones_like(frequencies)
        return np.asarray(across[None, :] / pole[:, None], np.complex128)
