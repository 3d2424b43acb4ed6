"""Diagnostics of a reconstruction: convergence and band limit."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FitDiagnostics:
    """Diagnostics of an iterative fit: iterations, stop reason and misfits.

    Attributes
    ----------
    iterations
        How many were done.
    stopped
        "discrepancy", "change", "misfit" (another would not pay) or "iterations": what ended them.
    products
        Products with the model or its transpose, and direct reconstructions, in all: what it cost.
    misfit
        ‖A f − g‖/‖g‖ when it was last looked at.
    misfits
        The same at the start of each iteration.
    """

    iterations: int
    stopped: str
    products: int
    misfit: float
    misfits: tuple[float, ...]


@dataclass(frozen=True)
class BandLimit:
    """Upper frequency limit of a reconstruction, and the share of the A-lines' power excluded by the limit.

    Attributes
    ----------
    highest_frequency_hz
        Only frequencies below were used.
    left_out
        Share of the A-lines' power that was above.
    """

    highest_frequency_hz: float
    left_out: float
