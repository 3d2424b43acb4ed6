"""Responses made of a film's response: its conjugate, its time derivative, and that of waves through layers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from steradian.imaging.film_response import FilmResponse
from steradian.imaging.medium import LayerPath

MIN_TRANSMISSION = 0.05
"""Transmission of pressure below which a wave is left out instead of amplified."""


@dataclass(frozen=True, slots=True)
class ConjugatedResponse:
    """Complex conjugate of a film response, for the adjoint."""

    response: FilmResponse

    def evaluate(
        self, frequencies: NDArray[np.float64], sines: NDArray[np.float64], sound_speed: float
    ) -> NDArray[np.complex128]:
        """Return the conjugate of the response."""
        return np.conj(self.response.evaluate(frequencies, sines, sound_speed))


@dataclass(frozen=True, slots=True)
class ResponseThroughLayers:
    """Response of the film to waves from a deeper layer, times the transmission, or divided by it."""

    path: LayerPath
    response: FilmResponse | None
    inverse: bool

    def evaluate(
        self, frequencies: NDArray[np.float64], sines: NDArray[np.float64], sound_speed: float
    ) -> NDArray[np.complex128]:
        """Return the response (F, S) over the angle within the deeper layer."""
        first = self.path.layers[0].sound_speed
        passed = self.path.transmission(sines)
        if self.inverse:
            passed = np.divide(1.0, passed, out=np.zeros(len(passed)), where=passed > MIN_TRANSMISSION)
        found = np.ones((len(frequencies), len(sines)), np.complex128) * passed
        if self.response is not None:
            at_film = np.minimum(sines * (first / self.path.sound_speed), 1.0)
            found *= self.response.evaluate(frequencies, at_film, first)
        return found


@dataclass(frozen=True, slots=True)
class TimeDerivative:
    """Response S of a film times ±2πif: the derivative of each wave by time."""

    response: FilmResponse | None
    sign: int = 1

    def evaluate(
        self, frequencies: NDArray[np.float64], sines: NDArray[np.float64], sound_speed: float
    ) -> NDArray[np.complex128]:
        """Return the response (F, S) at frequencies (F,) in Hz and sines (S,); sound speed outside in m/s."""
        f = np.asarray(frequencies, np.float64)
        # at 0 Hz, where the factor is 0, its phase is that of its neighbours: tables are interpolated in phase
        found = np.repeat(self.sign * 2j * np.pi * np.maximum(f, 1e-9)[:, None], len(sines), axis=1)
        return found if self.response is None else found * self.response.evaluate(f, sines, sound_speed)
