"""Checks of a plan against the capabilities of a connected scanner."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import fabry_perot
from steradian.core.exceptions import InvalidInput
from steradian.plans import ScanPlan
from steradian.scans.acquisition.excitation import check_excitation

BEAM_PATTERN_TOLERANCE = 1e-7
"""Beams are where a plan says to so many metres."""


def check_scanner(plan: ScanPlan, capabilities: fabry_perot.Capabilities) -> None:
    """Raise an error if the scanner does not meet the requirements of a plan, before a file is created."""
    check_pattern(plan.beams, capabilities)
    capabilities.check(
        plan.beam_positions,
        samples=plan.samples,
        sampling_interval=plan.sampling_interval,
        pulse_rate=plan.pulse_rate,
        averages=plan.averages,
    )
    capabilities.wavelengths(0.0 if plan.bias is None else plan.bias, plan.mask.count)
    capabilities.gated(plan.gate != "none", plan.mask.count)
    for wavelength in plan.excitation:
        check_excitation(capabilities, wavelength)


def check_pattern(beams: Sequence[tuple[float, float]], capabilities: fabry_perot.Capabilities) -> None:
    """Raise InvalidInput if the beam offsets of a plan are not those of the scanner's first beams."""
    theirs = capabilities.beam_offsets
    if len(beams) > len(theirs):
        raise InvalidInput("beams", f"{len(beams)} of them", f"at most {len(theirs)}, which this scanner has")
    if beams and not np.allclose(beams, theirs[: len(beams)], rtol=0, atol=BEAM_PATTERN_TOLERANCE):
        worst = int(np.abs(np.subtract(beams, theirs[: len(beams)])).max(axis=1).argmax())
        (x, y), (u, v) = beams[worst], theirs[worst]
        raise InvalidInput(f"beams[{worst}]", f"({x:g}, {y:g}) m", f"({u:g}, {v:g}) m, where this scanner's is")
