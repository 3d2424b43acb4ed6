"""Request of a figure for a paper or of a film of a series."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self, TypeAlias

from pydantic import ConfigDict, Field, model_validator

from steradian.core.exceptions import InvalidInput
from steradian.core.validation import Value, quantity_field
from steradian.jobs.request_base import Identifier, JobRequestBase, index_field

Axis: TypeAlias = Literal["x", "y", "z"]
Span: TypeAlias = tuple[float, float]
Share: TypeAlias = Annotated[float, Field(ge=0, le=1)]
FIGURE_EXAMPLE: dict[str, Any] = {
    "kind": "figure", "reconstruction_id": "r01jz0000000000000000000000", "format": "pdf", "width": 85e-3,
    "axes": ["z", "y"], "slab": {"y": [0.0, 0.0]},
}  # fmt: skip


class AxisSpans(Value):
    """First and last position along each axis; none: all."""

    x: Span | None = Field(default=None, description="First and last position along x (m)")
    y: Span | None = Field(default=None, description="First and last position along y (m)")
    z: Span | None = Field(default=None, description="First and last depth (m)")

    @model_validator(mode="after")
    def _check(self) -> Self:
        for name, span in self.by_axis().items():
            if span[0] > span[1]:
                raise InvalidInput(name, span, "the second not below the first")
        return self

    def by_axis(self) -> dict[str, Span]:
        """Return the spans that there are, by axis."""
        return {name: span for name in ("x", "y", "z") if (span := getattr(self, name)) is not None}


class FigureOverlay(Value):
    """Second volume whose colours are added to those of each panel."""

    reconstruction_id: Identifier = Field(description="Identifier of the series or reconstruction")
    index: int | None = index_field()
    colour_map: str = Field(default="cyan", max_length=40, description="As of the figure; black at zero adds nothing")
    limits: Span | None = Field(default=None, description="Ends of its colour scale; none: automatic")
    opacity: tuple[Share, Share] = Field(default=(1.0, 1.0), description="Of the panels' volume and of this one")
    label: str = Field(default="overlay (arb. u.)", max_length=100, description="Quantity and unit")

    @model_validator(mode="after")
    def _check(self) -> Self:
        check_scale(self.limits, self.label)
        return self


def check_scale(limits: Span | None, label: str) -> None:
    """Reject limits that do not rise and labels that cannot be printed; raises :class:`InvalidInput`."""
    if limits is not None and limits[0] >= limits[1]:
        raise InvalidInput("limits", limits, "the second above the first")
    if not label.isprintable():
        raise InvalidInput("label", repr(label), "printable characters")


class FigureRequest(JobRequestBase):
    """Request of a figure for a paper: projections side by side with one colour scale, or a film of a series."""

    model_config = ConfigDict(json_schema_extra={"examples": [FIGURE_EXAMPLE]})

    kind: Literal["figure"] = "figure"
    reconstruction_id: Identifier = Field(description="Identifier of the series or reconstruction")
    format: Literal["pdf", "svg", "png", "gif"] = Field(default="pdf", description="gif: a film of a series")
    indices: tuple[int, ...] | None = Field(
        default=None, min_length=1, max_length=36, description="Volumes of a series; none: all"
    )
    axis: Axis = Field(default="z", description="Axis of the projection, which disappears")
    axes: tuple[Axis, ...] | None = Field(
        default=None, min_length=1, max_length=3, description="Axes of which each has a panel; none: axis"
    )
    slab: AxisSpans = Field(
        default=AxisSpans(),
        description="Of each axis that disappears: the maximum between two positions, of equal ones the nearest slice",
    )
    region: AxisSpans = Field(default=AxisSpans(), description="What is shown along the axes of the panels")
    depth_coded: bool = Field(default=False, description="Colours are the depths of the maxima")
    near_field: float = quantity_field("m", "Depth above which nothing is shown", default=0.0, ge=0, le=1)
    colour_map: str = Field(
        default="inferno", max_length=40, description="A colour map of matplotlib, or red, green, cyan, magenta, …"
    )
    limits: Span | None = Field(default=None, description="Ends of the colour scale; none: automatic")
    gamma: float = Field(default=1.0, ge=0.1, le=5, description="Exponent of the share of the scale")
    log_range_db: float | None = quantity_field(
        "dB", "Range of a logarithmic colour scale; none: not logarithmic", default=None, ge=10, le=80
    )
    label: str = Field(default="initial pressure (arb. u.)", max_length=100, description="Quantity and unit")
    width: float = quantity_field("m", "Width of the page", default=85e-3, ge=35e-3, le=1)
    dpi: float = Field(default=300.0, ge=50, le=2400, description="Pixels an inch of a PNG")
    font_size: float = quantity_field("pt", "Size of letters", default=7.0, ge=4, le=24)
    interpolation: Literal["nearest", "linear"] = Field(default="nearest", description="Between voxels")
    overlay: FigureOverlay | None = Field(default=None, description="Volume that is laid over each; none: none")

    @model_validator(mode="after")
    def _check(self) -> Self:
        check_scale(self.limits, self.label)
        if self.overlay is not None and self.format == "gif":
            raise InvalidInput("overlay", self.overlay.reconstruction_id, "none of a film")
        if self.depth_coded and self.format == "gif":
            raise InvalidInput("depth_coded", "true", "false of a film")
        if self.format == "gif" and len(self.axes or ()) > 1:
            raise InvalidInput("axes", self.axes, "one axis of a film")
        if self.width * self.dpi > MOST_PIXELS * INCH:
            raise InvalidInput("dpi", self.dpi, f"at most {MOST_PIXELS * INCH / self.width:.0f} at this width")
        return self


INCH = 25.4e-3
MOST_PIXELS = 12_000
"""Most pixels across a page."""
