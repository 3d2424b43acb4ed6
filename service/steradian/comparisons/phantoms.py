"""Test objects by name, placed around a point of interest."""

from __future__ import annotations

from steradian.core.exceptions import InvalidInput
from steradian.phantoms import Balls, vessels, yarn

NAMES = ("vessel-tree", "yarn")
EARLIER = {"vessels": "vessel-tree"}
"""Names of before; the simulated scanner has another object called vessels."""
DEPTH_SHARE = 0.45
"""Half the depth of either over its lateral radius."""


def phantom(name: str, point: tuple[float, float, float], radius: float | None = None, *, seed: int = 0) -> Balls:
    """Return a test object by name: a tree of vessels or a knotted yarn.

    Parameters
    ----------
    name
        ``vessel-tree`` (also ``vessels``) or ``yarn``; objects of their own, not those of the simulated scanner.
    point
        Its middle x, y, z in metres.
    radius
        Its lateral radius in metres; ``None``: its own (3.5 and 3 mm), or less where it would reach the film.
    seed
        Varies it.

    Raises
    ------
    InvalidInput
        When there is no such phantom, or it would reach the film.
    """
    name = EARLIER.get(name, name)
    if name not in NAMES:
        raise InvalidInput("phantom", name, ", ".join(NAMES) + " or a volume file")
    most = point[2] / DEPTH_SHARE
    if radius is not None and not 0 < radius < most:
        raise InvalidInput("phantom_radius", radius, f"> 0, below {most:.4g} m, else it reaches the film")
    own = {"vessel-tree": 3.5e-3, "yarn": 3.0e-3}[name]
    wide = min(own, 0.8 * most) if radius is None else radius
    return vessels(seed, centre=point, radius=wide) if name == "vessel-tree" else yarn(seed, centre=point, radius=wide)
