"""Options of the commands for the medium: ``--layer`` and ``--attenuation``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer

from steradian.cli.console import length, speed
from steradian.core.exceptions import InvalidInput

if TYPE_CHECKING:
    from steradian.reconstructions.medium_parameters import AttenuationParameters, LayerParameters

MEDIUM = "The medium"
LayerOption: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--layer",
        metavar="<speed>:<length>:<density>",
        help="Layer of the medium, from the film downwards, in place of the speed of sound: 1480m/s:2mm, and 1580m/s "
        "for the last one, which has no thickness; densities (1480m/s:2mm:998kg/m3) for all layers or for none.",
        rich_help_panel=MEDIUM,
    ),
]
AttenuationOption: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--attenuation",
        metavar="<dB/(MHz^y cm)>,<y>",
        help="Attenuation to compensate: 0.75,1.5, or water, soft-tissue or none; once for each layer, in their order.",
        rich_help_panel=MEDIUM,
    ),
]
_DENSITY = re.compile(r"([-+0-9.eE]+)\s*kg/m(?:3|³)")
_LAYER = "a speed and, but for the last layer, a thickness, such as 1480m/s:2mm or 1480m/s:2mm:998kg/m3"


def parse_medium(
    layers: Sequence[str] | None, attenuations: Sequence[str] | None, sound_speed: float | None
) -> dict[str, Any]:
    """Return the reconstruction parameters ``sound_speed`` and ``medium`` of the options.

    Parameters
    ----------
    layers, attenuations
        Texts of the options.
    sound_speed
        In m/s; with attenuation and without layers that of the medium. None: the scan's.

    Raises
    ------
    InvalidInput
        Naming the option, its text and what is allowed.
    """
    if layers and sound_speed is not None:
        raise InvalidInput("sound-speed", f"{sound_speed:g} m/s", "none beside --layer, which states a speed")
    if not attenuations:
        return {"sound_speed": sound_speed, "medium": [parse_layer(text) for text in layers] if layers else None}
    from steradian.reconstructions.medium_parameters import LayerParameters

    found = [parse_layer(text) for text in layers or ()] or [LayerParameters.create(sound_speed=sound_speed)]
    if len(attenuations) != len(found):
        allowed = f"once for each layer, {len(found)} times; none for a lossless one"
        raise InvalidInput("attenuation", f"given {len(attenuations)} times", allowed)
    laws = [parse_attenuation(text) for text in attenuations]
    medium = [layer.replace(attenuation=law) for layer, law in zip(found, laws, strict=True)]
    return {"sound_speed": None, "medium": medium}


def parse_layer(text: str) -> LayerParameters:
    """Parse a layer, ``1480m/s:2mm`` or ``1480m/s:2mm:998kg/m3``; raises InvalidInput."""
    from steradian.reconstructions.medium_parameters import LayerParameters

    first, *rest = text.split(":")
    fields: dict[str, float] = {}
    try:
        fields["sound_speed"] = speed(first)
        for part in rest:
            density = _DENSITY.fullmatch(part.strip())
            name, value = ("density", float(density[1])) if density else ("thickness", length(part))
            if name in fields:
                raise ValueError
            fields[name] = value
    except (typer.BadParameter, ValueError):
        raise InvalidInput("layer", text, _LAYER) from None
    try:
        return LayerParameters.create(**fields)
    except InvalidInput as error:
        raise InvalidInput("layer", text, f"{error.field.replace('_', ' ')} {error.allowed}") from None


def parse_attenuation(text: str) -> AttenuationParameters | None:
    """Parse an attenuation, ``0.75,1.5`` or a name; none: lossless. Raises InvalidInput."""
    from steradian.imaging.attenuation import ATTENUATIONS
    from steradian.reconstructions.medium_parameters import AttenuationParameters

    named = {name.replace(" ", "-"): law for name, law in ATTENUATIONS.items()}
    word = text.strip().replace(" ", "-")
    if word == "none":
        return None
    if word in named:
        return AttenuationParameters.create(coefficient=named[word].coefficient, power=named[word].power)
    try:
        coefficient, power = (float(part) for part in text.split(","))
    except ValueError:
        allowed = f"a coefficient and a power, such as 0.75,1.5 (dB/(MHz^y cm), y); {', '.join(named)} or none"
        raise InvalidInput("attenuation", text, allowed) from None
    try:
        return AttenuationParameters.create(coefficient=coefficient, power=power)
    except InvalidInput as error:
        raise InvalidInput("attenuation", text, f"{error.field} {error.allowed}") from None
