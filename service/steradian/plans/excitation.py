"""Preview of a plan's excitation wavelengths: condition number and expected error of oxygen saturation."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import TYPE_CHECKING

from steradian.core.exceptions import InvalidInput

if TYPE_CHECKING:
    from steradian.plans.plan import ScanPlan
    from steradian.spectroscopy import TissueFluence

DEPTH = 3e-3
"""Depth of the blood in m where the mask has no point of interest."""


@dataclass(frozen=True)
class ExcitationPreview:
    """Preview of the excitation wavelengths of a plan, for both haemoglobins.

    Parameters
    ----------
    wavelengths
        Excitation wavelengths in m.
    depth
        Depth of the blood in m.
    noise
        Standard deviation of a voxel in the mean of a wavelength's frames, as a share of blood's value at the surface.
    condition
        Condition number of the spectra at the depth; None where ``reason`` says why.
    saturation_error
        Expected standard error of oxygen saturation of a voxel (68 %); None where ``reason`` says why.
    reason
        Reason why there are no figures; "" where there are.
    """

    wavelengths: tuple[float, ...]
    depth: float
    noise: float
    condition: float | None = None
    saturation_error: float | None = None
    reason: str = ""


def preview_excitation(
    plan: ScanPlan, *, depth: float | None = None, noise: float = 0.03, tissue: TissueFluence | None = None
) -> ExcitationPreview:
    """Return the expected error of oxygen saturation with the wavelengths of a plan.

    Parameters
    ----------
    plan
        The plan; its frames at each wavelength are averaged, which lowers the noise.
    depth
        Depth of the blood in m, 0 to 0.1; None: that of the mask's point of interest, else 3 mm.
    noise
        Standard deviation of a voxel in one frame, as a share of the value of blood at the surface.
    tissue
        Tissue around the blood; None: :class:`steradian.spectroscopy.TissueFluence` with its defaults.

    Raises
    ------
    InvalidInput
        If depth or noise is out of range.
    """
    from steradian.spectroscopy import TissueFluence, wavelength_set

    around = TissueFluence() if tissue is None else tissue
    chosen = depth if depth is not None else (plan.mask.depth or DEPTH)
    averaged = noise / sqrt(plan.frames)
    try:
        found = wavelength_set(plan.excitation or (800e-9,), depth=chosen, noise=averaged, tissue=around)
    except InvalidInput as error:
        if error.field == "noise" or (error.field == "depth" and depth is not None):
            raise
        reason = str(error) if plan.excitation else "the plan states no excitation wavelengths"
        return ExcitationPreview(plan.excitation, chosen, averaged, reason=reason)
    return ExcitationPreview(found.wavelengths, chosen, averaged, found.condition, found.saturation_error)
