"""Response of a sensing spot: the mean of the pressure over the interrogation beam.

A plane wave of the lateral wave number k = (ω/c)·sin θ is averaged to the Fourier transform of the beam's normalised
profile at k (Hankel transform of order 0):

    top hat of the diameter D = 2a:                           2·J₁(ka)/(ka)
    Gaussian e^{−2r²/w²} of the 1/e² diameter D = 2w:         e^{−k²w²/8}

J₁ changes its sign: the top hat has zeros, at ka = 3.83 the first one, and what it takes there is not to be had back.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from steradian.core.quantity_ranges import SPOT
from steradian.imaging import validation as checks
from steradian.imaging.film_response import FilmResponse

SpotProfile: TypeAlias = Literal["gaussian", "top-hat"]


@dataclass(frozen=True, slots=True)
class SensingSpot:
    """Sensing spot of finite size, as :class:`~steradian.imaging.film_response.FilmResponse`.

    Parameters
    ----------
    diameter
        Of a top hat, or the 1/e² diameter of a Gaussian beam, in m.
    profile
        "gaussian" or "top-hat".
    film
        Response of the film itself, which multiplies that of the spot; None: an ideal film.

    Raises
    ------
    InvalidInput
        If a value is out of range.
    """

    diameter: float
    profile: SpotProfile = "gaussian"
    film: FilmResponse | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "diameter", SPOT.check("diameter", self.diameter))
        checks.check_choice("profile", self.profile, get_args(SpotProfile))

    def evaluate(
        self, frequencies: NDArray[np.float64], sines: NDArray[np.float64], sound_speed: float
    ) -> NDArray[np.complex128]:
        """Return the response (F, S) at frequencies (F,) in Hz and sines (S,); sound speed outside in m/s."""
        k = 2 * np.pi / sound_speed * np.asarray(frequencies)[:, None] * np.asarray(sines)[None, :]
        found = np.asarray(self._averaged(k * self.diameter / 2), np.complex128)
        return found if self.film is None else found * self.film.evaluate(frequencies, sines, sound_speed)

    def _averaged(self, ka: NDArray[np.float64]) -> NDArray[np.float64]:
        if self.profile == "gaussian":
            return np.asarray(np.exp(-(ka**2) / 8))
        from scipy.special import j1

        return np.divide(2 * j1(ka), ka, out=np.ones(ka.shape), where=ka > 0)


def changes_sign(response: object) -> bool:
    """Return whether a response, or one inside, is that of a sensing spot with zeros."""
    while response is not None:
        if isinstance(response, SensingSpot):
            return response.profile == "top-hat"
        response = getattr(response, "response", None)
    return False
