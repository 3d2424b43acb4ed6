"""Medium between film and object: plane layers parallel to the film, each with a speed of sound.

The sound of a deeper layer crosses those above it. In the spectrum over the film that is one factor for each lateral
wavenumber and frequency (phase-shift extrapolation, J. Gazdag 1978): the wave of lateral wavenumber k and angular
frequency ω advances by k_z·d in a layer of the speed c and the thickness d, with k_z = sign(ω)·√(ω²/c² − |k|²).
Waves that are evanescent in a layer above, beyond its critical angle, do not reach the film.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import asin, degrees

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import DENSITY, LAYER_SPEED, LAYER_THICKNESS
from steradian.imaging.attenuation import Attenuation

Floats = NDArray[np.float64]
MAX_LAYERS = 16
"""Most layers of a medium."""


@dataclass(frozen=True, slots=True)
class Layer:
    """Homogeneous layer of a medium.

    Parameters
    ----------
    sound_speed
        In m/s.
    thickness
        In m; None for the last layer, which has no lower boundary.
    density
        In kg/m³, for the transmission at the boundaries; None: not known.
    attenuation
        Power law of attenuation, with dispersion; ``sound_speed`` is then meant at 1 MHz. None: lossless.

    Raises
    ------
    InvalidInput
        If a value is out of range.
    """

    sound_speed: float
    thickness: float | None = None
    density: float | None = None
    attenuation: Attenuation | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "sound_speed", LAYER_SPEED.check("sound_speed", self.sound_speed))
        if self.thickness is not None:
            object.__setattr__(self, "thickness", LAYER_THICKNESS.check("thickness", self.thickness))
        if self.density is not None:
            object.__setattr__(self, "density", DENSITY.check("density", self.density))
        if not isinstance(self.attenuation, Attenuation | None):
            raise InvalidInput("attenuation", type(self.attenuation).__name__, "an Attenuation, or None")


@dataclass(frozen=True, slots=True)
class Medium:
    """Layered medium; the first layer is at the film, the last one has no lower boundary.

    Parameters
    ----------
    layers
        From the film downwards; each but the last has a thickness. Densities are given for all layers or for none:
        with them, amplitudes are corrected for the transmission at the boundaries.

    Raises
    ------
    InvalidInput
        If a thickness is missing or superfluous, some but not all layers have a density, or there are too many.
    """

    layers: tuple[Layer, ...]

    def __init__(self, layers: Sequence[Layer]) -> None:
        found = tuple(layers)
        if not 1 <= len(found) <= MAX_LAYERS:
            raise InvalidInput("layers", f"{len(found)} layers", f"1 to {MAX_LAYERS}")
        for number, layer in enumerate(found, start=1):
            if not isinstance(layer, Layer):
                raise InvalidInput("layers", type(layer).__name__, "Layer(sound_speed, thickness) values")
            if number < len(found) and layer.thickness is None:
                raise InvalidInput("thickness", f"none for layer {number} of {len(found)}", str(LAYER_THICKNESS))
        if found[-1].thickness is not None:
            allowed = "none for the last layer, which has no lower boundary"
            raise InvalidInput("thickness", found[-1].thickness, allowed)
        given = sum(layer.density is not None for layer in found)
        if given not in (0, len(found)):
            raise InvalidInput("density", f"given for {given} of {len(found)} layers", "for all layers, or for none")
        object.__setattr__(self, "layers", found)

    @property
    def boundaries(self) -> tuple[float, ...]:
        """Depths in m of the boundaries between layers, one fewer than layers."""
        return tuple(float(d) for d in np.cumsum([layer.thickness for layer in self.layers[:-1]]))

    @property
    def slowest(self) -> float:
        """Lowest speed of sound of all layers in m/s; it sets the depth step of images."""
        return min(layer.sound_speed for layer in self.layers)

    @property
    def fastest(self) -> float:
        """Highest speed of sound of all layers in m/s."""
        return max(layer.sound_speed for layer in self.layers)

    @property
    def lossy(self) -> bool:
        """Whether a layer attenuates."""
        return any(each.attenuation is not None and each.attenuation.coefficient > 0 for each in self.layers)

    @property
    def lossless(self) -> Medium:
        """The same layers without attenuation."""
        return Medium([replace(each, attenuation=None) for each in self.layers])

    def depth_at(self, time: float) -> float:
        """Return the depth in m from which sound along the film's normal needs ``time`` (s) to the film."""
        depth = 0.0
        for layer in self.layers[:-1]:
            assert layer.thickness is not None  # noqa: S101 - checked in __init__
            needed = layer.thickness / layer.sound_speed
            if time <= needed:
                break
            depth, time = depth + layer.thickness, time - needed
        else:
            layer = self.layers[-1]
        return depth + layer.sound_speed * time

    def time_at(self, depth: float) -> float:
        """Return the time in s that sound from a depth (m) needs to the film along the normal."""
        time, top = 0.0, 0.0
        for layer in self.layers[:-1]:
            assert layer.thickness is not None  # noqa: S101 - checked in __init__
            time += max(0.0, min(layer.thickness, depth - top)) / layer.sound_speed
            top += layer.thickness
        return time + max(0.0, depth - top) / self.layers[-1].sound_speed

    def layer_paths(self) -> list[LayerPath]:
        """Return for each layer the path from it to the film."""
        edges = (0.0, *self.boundaries, np.inf)
        return [LayerPath(self.layers[: i + 1], edges[i], edges[i + 1]) for i in range(len(self.layers))]

    def __str__(self) -> str:
        parts = [f"{layer.sound_speed:g} m/s" for layer in self.layers]
        for i, layer in enumerate(self.layers):
            if layer.attenuation is not None:
                parts[i] += f" with {layer.attenuation}"
        for i, depth in enumerate(self.boundaries):
            parts[i] += f" to {1e3 * depth:g} mm"
        return ", ".join(parts)


@dataclass(frozen=True, slots=True)
class LayerPath:
    """Path of sound from one layer to the film.

    Parameters
    ----------
    layers
        From the film down to the layer itself.
    top, bottom
        Depths of the layer's boundaries in m; ``bottom`` is infinite for the last layer.
    """

    layers: tuple[Layer, ...]
    top: float
    bottom: float

    @property
    def sound_speed(self) -> float:
        """Speed of sound of the layer in m/s."""
        return self.layers[-1].sound_speed

    @property
    def overlying(self) -> tuple[Layer, ...]:
        """Layers above this one."""
        return self.layers[:-1]

    @property
    def medium(self) -> Medium:
        """These layers as a medium, the layer itself without a lower boundary."""
        return Medium([*self.overlying, replace(self.layers[-1], thickness=None)])

    @property
    def critical_angle(self) -> float | None:
        """Angle to the normal in degrees, within the layer, beyond which sound does not reach the film; None: none."""
        fastest = max((layer.sound_speed for layer in self.overlying), default=0.0)
        return degrees(asin(self.sound_speed / fastest)) if fastest > self.sound_speed else None

    def transmission(self, sines: Floats) -> Floats:
        """Return the pressure at the film over that of the same wave without boundaries.

        Parameters
        ----------
        sines
            (S,) sines of the angle to the normal within the layer.

        Returns
        -------
        Array (S,): product over the boundaries of 2·Z_upper/(Z_upper + Z_lower) with Z = ρc/cos θ; 0 beyond the
        critical angle; 1 where densities are not given.
        """
        s = np.asarray(sines, np.float64)
        found = np.ones(s.shape)
        cosines = [np.sqrt(np.maximum(1 - (s * a.sound_speed / self.sound_speed) ** 2, 0)) for a in self.layers]
        for layer in self.overlying:
            found[s * layer.sound_speed > self.sound_speed] = 0
        impedances = [0.0 if a.density is None else a.density * a.sound_speed for a in self.layers]
        if not impedances[0]:
            return found
        for i in range(len(self.layers) - 1):
            above, below = impedances[i] * cosines[i + 1], impedances[i + 1] * cosines[i]
            total = above + below
            found *= np.divide(2 * above, total, out=np.zeros(s.shape), where=total > 0)
        return found
