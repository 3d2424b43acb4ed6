"""Response schemas of a series' frames and of an unmixing."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from steradian.api.schemas.report_base import ReportBase


class FrameView(ReportBase):
    """Volume of a series: its frames, wavelength and time, or the name of a map of an unmixing."""

    numbers: list[int] | None = Field(default=None, description="Frames of the scan that it is made of", examples=[[0]])
    excitation_m: float | None = Field(default=None, description="Excitation wavelength (m); 0: not stated")
    time_s: float | None = Field(default=None, description="Since the first shot of the series (s); null: not known")
    name: str | None = Field(default=None, description="Of a map of an unmixing", examples=["saturation"])
    sensors: int | None = Field(default=None, description="A-lines the image is made of")
    planned: int | None = Field(default=None, description="A-lines that the frame was to have")
    notes: list[str] | None = None
    iterations: int | None = Field(default=None, description="Of the iterative method")
    misfit: float | None = Field(default=None, description="Of the image, relative to the A-lines")
    maximum: float | None = Field(default=None, description="Greatest value")
    shift: dict[str, Any] | None = Field(default=None, description="Shift of the object that was looked for, in m")
    motion: dict[str, Any] | None = Field(default=None, description="Motion within the frame that was looked for")


class OxygenationView(ReportBase):
    """Expected error of oxygen saturation with a plan's excitation wavelengths, in tissue of usual composition."""

    wavelengths: list[float] | None = Field(default=None, description="Excitation wavelengths (m)")
    depth: float | None = Field(default=None, description="Depth of the blood (m): the mask's, else 3 mm")
    noise: float | None = Field(
        default=None, description="Of a voxel in the mean of a wavelength's frames, as a share of blood at the surface"
    )
    condition: float | None = Field(default=None, description="Condition number of the spectra at that depth")
    saturation_error: float | None = Field(default=None, description="Expected standard error of a voxel (68 %)")
    reason: str | None = Field(default=None, description="Why there are no figures; empty where there are")


class UnmixingView(ReportBase):
    """Result of an unmixing: chromophores, model of the light, and statistics of oxygen saturation."""

    chromophores: list[str] | None = None
    wavelengths_m: list[float] | None = Field(default=None, description="Wavelengths used (m)")
    fluence: dict[str, Any] | None = Field(default=None, description="Model of the light, with its parameters")
    voxels: int | None = Field(default=None, description="Voxels with signal")
    misfit: float | None = Field(default=None, description="Reduced χ² of the fit")
    saturation: dict[str, float] | None = Field(
        default=None, description="Mean, percentiles 5, 50 and 95, and a voxel's median standard error"
    )


class RegionsView(ReportBase):
    """Result of a measurement of regions: a row for each volume and region, and the courses over time."""

    rows: list[dict[str, Any]] | None = Field(
        default=None,
        description="With name, frames, excitation (m), time (s), voxels, size (m³), mean, deviation, minimum, maximum,"
        " percentiles and contrast_to_noise",
    )
    courses: list[dict[str, Any]] | None = Field(
        default=None, description="Of each region and wavelength: mean, deviation, temporal_snr and the fit"
    )
