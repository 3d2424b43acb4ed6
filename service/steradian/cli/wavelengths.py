"""``steradian wavelengths``: the best wavelengths of a laser for oxygen saturation at a depth."""

from __future__ import annotations

from typing import Annotated

import typer

from steradian.cli.console import length, quantity_option, show_figures
from steradian.core.exceptions import InvalidInput


def wavelengths(
    candidates: Annotated[
        str, typer.Option("--from", help="Wavelengths of the laser in nm: first:last:step, or a list: 700,750,800.")
    ] = "700:900:5",
    count: Annotated[int, typer.Option(help="How many to choose.")] = 5,
    chromophore: Annotated[
        list[str] | None,
        typer.Option(help="Chromophore to unmix beside both haemoglobins: water, lipid, melanin, ICG."),
    ] = None,
    depth: Annotated[float, quantity_option(length, "3mm", help="Depth of the blood.")] = 3e-3,
    noise: Annotated[
        float, typer.Option(help="Standard deviation of a voxel, as a share of blood's value at the surface.")
    ] = 0.03,
    blood: Annotated[float, typer.Option(help="Volume fraction of blood in the tissue above.")] = 0.02,
    saturation: Annotated[float, typer.Option(help="Oxygen saturation of that blood, 0 to 1.")] = 0.7,
) -> None:
    """Choose the wavelengths with the least expected error of oxygen saturation, and compare them with even spacing."""
    from steradian.spectroscopy import TissueFluence, best_wavelengths, wavelength_set
    from steradian.spectroscopy.wavelength_design import HAEMOGLOBINS

    light = parse_wavelengths(candidates)
    names = [*HAEMOGLOBINS, *(chromophore or ())]
    tissue = TissueFluence(blood=blood, saturation=saturation)
    best = best_wavelengths(light, count, names, depth=depth, noise=noise, tissue=tissue)
    spread = [light[round(step * (len(light) - 1) / max(1, count - 1))] for step in range(count)]
    even = wavelength_set(spread, names, depth=depth, noise=noise, tissue=tissue)
    for title, found in (("Best wavelengths", best), ("Evenly spaced", even)):
        figures = {
            "wavelengths": ", ".join(f"{1e9 * each:g}" for each in found.wavelengths) + " nm",
            "expected error": f"sO2 ± {found.saturation_error:.2g} of a voxel at {1e3 * depth:g} mm",
            "condition": f"{found.condition:.3g}",
        }
        show_figures(title, figures)


def parse_wavelengths(text: str) -> list[float]:
    """Parse ``700:900:5`` or ``700,750,800`` (nm) to wavelengths in m; raises InvalidInput."""
    allowed = "first:last:step or a list in nm, such as 700:900:5 or 700,750,800"
    try:
        numbers = [float(part) for part in text.replace(":", ",").split(",")]
    except ValueError:
        raise InvalidInput("from", text, allowed) from None
    if ":" not in text:
        return [1e-9 * each for each in numbers]
    if text.count(":") != 2 or len(numbers) != 3:
        raise InvalidInput("from", text, allowed)
    first, last, step = numbers
    steps = (last - first) / step if step > 0 else -1.0
    if not 0 <= steps < 500:
        raise InvalidInput("from", text, f"{allowed}; at most 500, rising")
    return [1e-9 * (first + step * n) for n in range(int(steps + 1e-9) + 1)]
