"""Scan file as a Python object: metadata, A-lines, reconstruction."""

from __future__ import annotations

import shutil
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from steradian.core.atomic_files import atomic_write
from steradian.core.exceptions import InvalidInput
from steradian.drawing.mpl_style import PICTURES, colour_bar, page, save, style_axes
from steradian.drawing.notebook import WIDTH, html_plot, resolve_axes
from steradian.imaging import Volume
from steradian.masks import Mask
from steradian.plans import ScanPlan
from steradian.plans.stages import StageRecord
from steradian.quality import PulseNoise
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.run import reconstruct_in_memory
from steradian.reconstructions.scan_plan_reader import StoredPlan, read_stored_plan
from steradian.scans.file.read import list_frames, read_scan
from steradian.scans.file.stages import read_stages
from steradian.scans.frames import Frame, FrameChoice
from steradian.scans.opening import open_recording
from steradian.scans.pulse_noise import pulse_noise_of
from steradian.scans.recording import Recording

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from steradian.reconstructions.series.series import Series


class Scan:
    """Scan file as an object with metadata, A-lines and reconstruction; returned by :func:`steradian.open`.

    Plan and counts are read when it is opened, A-lines when they are asked for.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    DamagedFile
        When it cannot be read as a scan.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._said: StoredPlan = read_stored_plan(self.path)

    @property
    def plan(self) -> ScanPlan:
        """Scan plan, with its mask."""
        return self._said.plan

    @property
    def mask(self) -> Mask:
        """Mask of the scan."""
        return self.plan.mask

    @property
    def simulated(self) -> bool:
        """Whether the A-lines are simulated."""
        return self._said.simulated

    @property
    def planned(self) -> int:
        """Number of A-lines in the plan, all frames together."""
        return int(self._said.summary["points"])

    @cached_property
    def stored(self) -> int:
        """Number of stored A-lines at the time of opening."""
        return int(self._said.summary["stored"])

    @property
    def stages(self) -> tuple[StageRecord, ...]:
        """Records of the stages, first the survey; empty for a scan of one stage."""
        return read_stages(self.path)

    @property
    def frames(self) -> tuple[Frame, ...]:
        """Frames of the scan (repetitions or wavelengths), with excitation wavelength and A-line counts."""
        return list_frames(self.path)

    def recording(self, frame: int | FrameChoice | None = None) -> Recording:
        """Read the stored, intact A-lines of a frame, with positions, weights and times.

        Parameters
        ----------
        frame
            Its number, from 0; None: the only one. A :class:`FrameChoice` selects by wavelength, or several frames: of
            these all rows are returned, and :attr:`Recording.points` tells which belong together.

        Raises
        ------
        InvalidInput
            When there is no such frame, or none is named of several.
        DamagedFile
            When it holds no A-line.
        """
        return open_recording(self.path, frame) if isinstance(frame, FrameChoice) else read_scan(self.path, frame)

    def pulse_noise(self, frame: int | FrameChoice | None = None) -> PulseNoise:
        """Measure the signal-to-noise ratio of one laser pulse in a frame, for :func:`steradian.design_scan`.

        Raises
        ------
        InvalidInput
            When no A-line stands out of the noise, or as :meth:`recording`.
        """
        return pulse_noise_of(self.recording(frame))

    def reconstruct(self, *, frame: int | FrameChoice | None = None, **parameters: Any) -> Volume:
        """Reconstruct one frame, or the mean of several frames.

        Parameters
        ----------
        frame
            From 0; None: the only one. ``FrameChoice(wavelength=750e-9, average=True)``: the mean of those at 750 nm.
        parameters
            As in the HTTP API, for example ``modes=226, depth_range=(1e-3, 8e-3), method="iterative"``; what is left
            out is as the scan says.

        Raises
        ------
        InvalidInput
            When a parameter is unknown, out of range or does not fit the scan, or ``frame`` is None and the scan has
            several.
        """
        return reconstruct_in_memory(self.recording(frame), ReconstructionParameters.create(**parameters))

    def series(self, *, wavelength: float | None = None, average: bool = False, **parameters: Any) -> Series:
        """Reconstruct all frames into a series of volumes on the same voxels.

        Parameters
        ----------
        wavelength
            Excitation wavelength in m to which the series is limited; None: all.
        average
            The mean of the frames at each wavelength, instead of each frame.
        parameters
            As of :meth:`reconstruct`.

        Raises
        ------
        InvalidInput
            When a parameter is unknown, out of range or does not fit the scan, or no frame has the wavelength.
        """
        from steradian.reconstructions.series.reconstruct import series_in_memory

        chosen = ReconstructionParameters.create(**parameters)
        return series_in_memory(self.path, chosen, wavelength=wavelength, average=average)

    def plot(self, axes: Axes | None = None, *, frame: int | None = None) -> Axes:
        """Plot the A-lines of a frame as an image, sorted by distance from the middle.

        Parameters
        ----------
        axes
            A matplotlib plot to draw into; None: a new one.
        frame
            From 0; None: the only one.
        """
        axes = resolve_axes(axes)
        found = self.recording(frame)
        order = np.argsort(np.linalg.norm(found.positions, axis=1), kind="stable")
        scale = np.broadcast_to(np.asarray(found.scale, np.float32), len(order))
        traces = found.traces[order] * scale[order, None]
        end = float(np.percentile(np.abs(traces), 99.9)) or 1.0
        first = 1e6 * found.time_zero
        last = first + 1e6 * found.sampling_interval * traces.shape[1]
        extent = (0.0, float(len(order)), last, first)
        shown = axes.imshow(traces.T, extent=extent, aspect="auto", cmap="RdBu_r", vmin=-end, vmax=end)
        colour_bar(axes, shown, "pressure (arb. u.)")
        title = f"{len(order):,} A-lines" + ("" if len(order) == found.planned else f" of {found.planned:,}")
        style_axes(axes, title=title, across="A-line, from the middle outwards", up="time (µs)")
        return axes

    def save(self, path: str | Path) -> None:
        """Copy the scan file to ``.h5``, or plot its A-lines into ``.png``, ``.pdf`` or ``.svg``.

        ``steradian export`` writes it for other programs.

        Raises
        ------
        InvalidInput
            When the ending is another one.
        """
        wanted = Path(path)
        ending = wanted.suffix.lower()
        if ending in PICTURES:
            figure = page(2 * WIDTH, 0.6)
            self.plot(figure.add_subplot())
            save(figure, wanted)
        elif ending == ".h5":
            wanted.parent.mkdir(parents=True, exist_ok=True)
            with atomic_write(wanted) as file:
                shutil.copyfile(self.path, file)
        else:
            allowed = ".h5; or .png, .pdf or .svg for a picture"
            raise InvalidInput("file", f"{wanted.name} ({ending or 'no ending'})", allowed)

    def __repr__(self) -> str:
        lines = (
            f"{self.stored:,} of {self.planned:,} A-lines"
            if self.stored < self.planned
            else f"{self.planned:,} A-lines"
        )
        plan, kind = self.plan, ", simulated" if self.simulated else ""
        frames = f" in {plan.frame_count} frames" if plan.frame_count > 1 else ""
        record = f"{plan.samples} samples every {1e9 * plan.sampling_interval:g} ns"
        return f"<Scan {self.path.name}: {lines}{frames}, {record}{kind}>"

    def _repr_html_(self) -> str:
        return html_plot(repr(self), self.plot) if self.stored else f"<code>{repr(self)[1:-1]}</code>"
