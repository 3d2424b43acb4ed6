"""Maps of an unmixing: files of its volumes, and the picture of oxygen saturation."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from steradian.core.atomic_files import atomic_write
from steradian.imaging import Volume
from steradian.reconstructions.series.file import SeriesMetadata, SeriesWriter
from steradian.reconstructions.series.frames import SeriesFrame
from steradian.reconstructions.volumes.file import write_volume
from steradian.reconstructions.volumes.images import extent_mm
from steradian.spectroscopy import Unmixed


@dataclass
class MapReport:
    """Report of the maps of an unmixed series, as written to ``report.json``; fields as of a series' report."""

    shape: tuple[int, ...]
    axes: str
    spacing_m: tuple[float, ...]
    origin_m: tuple[float, ...]
    centre_m: tuple[float, ...]
    near_field_m: float
    parameters: dict[str, Any]
    provenance: dict[str, str]
    frames: list[dict[str, Any]]
    unmixing: dict[str, Any]
    notes: tuple[str, ...]
    seconds: dict[str, float] = field(default_factory=dict)
    files: list[str] = field(default_factory=list)

    @classmethod
    def of(
        cls,
        volume: Volume,
        about: SeriesMetadata,
        frames: list[SeriesFrame],
        unmixing: dict[str, Any],
        notes: tuple[str, ...],
    ) -> MapReport:
        """Return the report of maps on the voxels of ``volume``, made of a series with this metadata."""
        return cls(
            volume.values.shape,
            ", ".join(volume.names),
            tuple(map(float, volume.spacing)),
            tuple(map(float, volume.origin)),
            about.centre,
            about.near_field,
            about.parameters,
            about.provenance,
            [{"name": frame.name, "numbers": ()} for frame in frames],
            unmixing,
            notes,
        )


def maps_of(found: Unmixed) -> dict[str, Volume]:
    """Return the volumes of an unmixing by name: saturation, its error and haemoglobin first, then chromophores."""
    maps: dict[str, Volume] = {}
    if found.saturation is not None and found.saturation_error is not None:
        maps |= {name: found.as_volume(name) for name in ("saturation", "saturation-error", "haemoglobin")}
    return maps | {name: found.as_volume(name) for name in found.chromophores}


def write_maps(found: Unmixed, output: Path, provenance: dict[str, Any]) -> None:
    """Write each map into a volume file of its own, ``saturation.h5`` and so on."""
    output.mkdir(parents=True, exist_ok=True)
    for name, volume in maps_of(found).items():
        projections = project_finite(volume)
        write_volume(output / f"{name}.h5", volume, parameters={}, provenance=provenance, projections=projections)


def write_map_series(found: Unmixed, path: Path, of: SeriesMetadata, provenance: dict[str, Any]) -> list[SeriesFrame]:
    """Write the maps into one series file, with a frame for each; return the frames.

    Parameters
    ----------
    found
        The unmixing.
    path
        File to write.
    of
        Metadata of the series that was unmixed.
    provenance
        In addition to that of the series.
    """
    frames = []
    about: dict[str, Any] = {"parameters": of.parameters, "provenance": of.provenance | provenance}
    with SeriesWriter(path, centre=of.centre, **about) as writer:
        for name, volume in maps_of(found).items():
            frames.append(SeriesFrame((), name=name))
            writer.add(frames[-1], volume, projections=project_finite(volume), near_field=of.near_field)
    return frames


def project_finite(volume: Volume) -> Any:
    """Return the maxima along each axis, NaN left out; None for a 2-D image."""
    if volume.dimensions != 3:
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # columns without any signal stay NaN
        return {name: np.nanmax(volume.values, axis=number) for number, name in enumerate("xyz")}


def draw_saturation(found: Unmixed, path: Path) -> None:
    """Draw oxygen saturation at the depth of most haemoglobin as colour, and that haemoglobin as brightness (PNG)."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    volume = found.as_volume("saturation")
    haemoglobin = np.nan_to_num(found.as_volume("haemoglobin").values)
    place = haemoglobin.argmax(axis=2)[..., None]
    height = np.take_along_axis(haemoglobin, place, axis=2)[..., 0]
    value = np.nan_to_num(np.take_along_axis(volume.values, place, axis=2)[..., 0])
    brightness = np.clip(height / (np.percentile(height[height > 0], 95) if (height > 0).any() else 1.0), 0, 1)
    shown = colormaps["coolwarm"](value)[..., :3] * brightness[..., None]
    figure = Figure(figsize=(6.4, 5.2), dpi=110, layout="constrained")
    axes = figure.add_subplot()
    left, right = extent_mm(volume, "x")
    bottom, top = extent_mm(volume, "y")
    axes.imshow(shown.transpose(1, 0, 2), origin="lower", extent=(left, right, bottom, top))
    bar = figure.colorbar(ScalarMappable(Normalize(0, 1), colormaps["coolwarm"]), ax=axes)
    bar.set_label("oxygen saturation")
    inside = np.isfinite(volume.values)
    error = 0.0 if found.saturation_error is None or not inside.any() else float(np.nanmedian(found.saturation_error))
    axes.set_title(f"Oxygen saturation where haemoglobin is highest; median error ± {error:.2g}", fontsize=10)
    axes.set_xlabel("x (mm)")
    axes.set_ylabel("y (mm)")
    with atomic_write(path) as file:
        figure.savefig(file, format="png")
