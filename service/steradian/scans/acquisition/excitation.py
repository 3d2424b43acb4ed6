"""Tuning of the excitation laser, and validation of its wavelength."""

from __future__ import annotations

import fabry_perot
from steradian.core.exceptions import InvalidInput

PARAMETER = "excitation_pm"
"""The scanner's parameter that tunes its excitation laser."""


def tune_excitation(scanner: fabry_perot.Scanner, wavelength: float) -> None:
    """Tune the excitation laser to a wavelength in m; 0 leaves the wavelength unchanged.

    Raises
    ------
    InvalidInput
        When the scanner cannot.
    """
    if wavelength:
        check_excitation(scanner.capabilities, wavelength)
        scanner.set(**{PARAMETER: round(1e12 * wavelength)})


def check_excitation(capabilities: fabry_perot.Capabilities, wavelength: float) -> None:
    """Raise :class:`InvalidInput` if a scanner's laser cannot be tuned to a wavelength (m)."""
    allowed = capabilities.parameters.get(PARAMETER)
    if allowed is None:
        raise InvalidInput("excitation", f"{1e9 * wavelength:g} nm", "none: this scanner does not tune its excitation")
    low, high = allowed
    if not low <= round(1e12 * wavelength) <= high:
        span = f"{low * 1e-3:g} to {high * 1e-3:g} nm"
        raise InvalidInput("excitation", f"{1e9 * wavelength:g} nm", span)
