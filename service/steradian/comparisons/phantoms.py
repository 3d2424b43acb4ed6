"""Objects by name, placed around a point of interest."""

from __future__ import annotations

from steradian.errors import InvalidInput
from steradian.phantoms import Balls, vessels, yarn

NAMES = ("vessels", "yarn")
DEPTH_SHARE = 0.45
"""Half the depth of either over its lateral radius."""


def phantom(name: str, point: tuple[float, float, float], radius: float | None = None, *, seed: int = 0) -> Balls:
    """Make a tree of vessels or a knotted yarn.

    Parameters
    ----------
    name
        ``vessels`` or ``yarn``.
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
    if name not in NAMES:
        raise InvalidInput("phantom", name, ", ".join(NAMES) + " or a volume file")
    most = point[2] / DEPTH_SHARE
    if radius is not None and not 0 < radius < most:
        raise InvalidInput("phantom_radius", radius, f"> 0, below {most:.4g} m, else it reaches the film")
    own = {"vessels": 3.5e-3, "yarn": 3.0e-3}[name]
    wide = min(own, 0.8 * most) if radius is None else radius
    return vessels(seed, centre=point, radius=wide) if name == "vessels" else yarn(seed, centre=point, radius=wide)
