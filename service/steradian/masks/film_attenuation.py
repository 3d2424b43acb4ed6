"""Empirical directivity loss of a Fabry–Pérot film.

The paper (section 4.2, after Cox and Beard 2007) states two figures for 62°: below 1 MHz less than 5 dB, around 2 MHz
more than 10 dB. The rule here goes through both: 5 dB a MHz at 62°, growing with sin²θ from nothing at normal
incidence. It says nothing of the film's resonances, so it is quoted up to 2 MHz only.
"""

from __future__ import annotations

from math import radians, sin

from steradian.core.exceptions import InvalidInput

REFERENCE_ANGLE = radians(62)
REFERENCE_SLOPE = 5e-6
"""dB per Hz at the reference angle."""
HIGHEST = 2e6
"""Highest frequency in Hz that the rule covers."""


def attenuation_db(angle: float, frequency: float) -> float:
    """Return the loss in dB at an angle of incidence relative to normal incidence.

    Parameters
    ----------
    angle
        Angle of incidence in radians, 0 at normal incidence, below π/2.
    frequency
        In Hz, at most 2 MHz.

    Returns
    -------
    float
        dB, at least 0.

    Raises
    ------
    InvalidInput
        Naming the parameter and its allowed range.
    """
    if not 0 <= angle < radians(90):
        raise InvalidInput("angle", angle, "at least 0, below π/2 (rad)")
    if not 0 <= frequency <= HIGHEST:
        raise InvalidInput("frequency", frequency, "0 to 2e6 (Hz), the range of the paper's figures")
    return REFERENCE_SLOPE * frequency * (sin(angle) / sin(REFERENCE_ANGLE)) ** 2
