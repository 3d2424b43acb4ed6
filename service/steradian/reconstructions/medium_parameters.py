"""Layers of the medium as parameters of a reconstruction request."""

from __future__ import annotations

from collections.abc import Sequence

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import ATTENUATION, ATTENUATION_POWER, DENSITY, LAYER_SPEED, LAYER_THICKNESS
from steradian.core.validation import Value, quantity_field
from steradian.imaging.attenuation import Attenuation
from steradian.imaging.medium import Layer, Medium


class AttenuationParameters(Value):
    """Power law of acoustic attenuation, coefficient·(f/MHz)^power, with dispersion."""

    coefficient: float = quantity_field(ATTENUATION.unit, "Attenuation at 1 MHz", **ATTENUATION.limits)
    power: float = quantity_field(ATTENUATION_POWER.unit, "Exponent y", **ATTENUATION_POWER.limits)


class LayerParameters(Value):
    """Layer of the medium, parallel to the film."""

    sound_speed: float | None = quantity_field(
        "m/s", "Speed of sound, at 1 MHz with attenuation; none: the scan's", default=None, **LAYER_SPEED.limits
    )
    thickness: float | None = quantity_field(
        "m", "Thickness; none for the last layer, which has no lower boundary", default=None, **LAYER_THICKNESS.limits
    )
    density: float | None = quantity_field(
        "kg/m³", "Density, for all layers or for none: corrects transmission", default=None, **DENSITY.limits
    )
    attenuation: AttenuationParameters | None = None

    def layer(self) -> Layer:
        """Return the layer as a value of the library; ``sound_speed`` must be given."""
        given = self.attenuation
        law = None if given is None else Attenuation(given.coefficient, given.power)
        return Layer(self.sound_speed or 0.0, self.thickness, self.density, law)


def check_layers(layers: Sequence[LayerParameters]) -> None:
    """Raise ``InvalidInput`` for a missing or superfluous thickness, and for densities of some but not all layers."""
    dense = any(layer.density is not None for layer in layers)
    for i, layer in enumerate(layers):
        if i == len(layers) - 1 and layer.thickness is not None:
            allowed = "none for the last layer, which has no lower boundary"
            raise InvalidInput(f"medium.{i}.thickness", layer.thickness, allowed)
        if i < len(layers) - 1 and layer.thickness is None:
            raise InvalidInput(f"medium.{i}.thickness", "missing", f"{LAYER_THICKNESS}; only the last layer has none")
        if dense and layer.density is None:
            raise InvalidInput(f"medium.{i}.density", "missing", f"{DENSITY}; for all layers or for none")


def with_speeds(layers: Sequence[LayerParameters], sound_speed: float | None) -> tuple[LayerParameters, ...]:
    """Return the layers with the scan's speed of sound in m/s where they have none; None: the scan states none.

    Raises
    ------
    InvalidInput
        When a speed is missing.
    """
    for i, layer in enumerate(layers):
        if layer.sound_speed is None and not sound_speed:
            raise InvalidInput(f"medium.{i}.sound_speed", "missing", f"{LAYER_SPEED}; the recording states none")
    return tuple(layer if layer.sound_speed is not None else layer.replace(sound_speed=sound_speed) for layer in layers)


def build_medium(layers: Sequence[LayerParameters], sound_speed: float | None = None) -> Medium:
    """Return the medium of these layers; arguments and errors as of :func:`with_speeds`."""
    return Medium([layer.layer() for layer in with_speeds(layers, sound_speed)])
