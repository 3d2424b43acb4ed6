"""Admission checks before jobs are queued: existence of inputs, size of volumes, estimates of disk and memory."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from steradian.api.errors.handlers import NotReady
from steradian.api.services import ServiceContainer
from steradian.api.use_cases.image_size import expected_shape, least_memory
from steradian.core.exceptions import Conflict, InvalidInput, NotFound
from steradian.jobs.figure_request import FigureRequest
from steradian.jobs.reconstruction_request import ReconstructionRequest
from steradian.jobs.requests import (
    ExportRequest,
    ImportRequest,
    QualityRequest,
    RegionsRequest,
    SoundSpeedRequest,
    WidthRequest,
    WorkRequest,
)
from steradian.reconstructions.parameters import LARGE, ReconstructionParameters
from steradian.reconstructions.volumes.pyramid import file_size
from steradian.scans.frames import Frame
from steradian.storage.blobs.interface import result_name, scan_name, upload_name
from steradian.storage.capacity.reserve import scan_bytes
from steradian.storage.data_dir.job_directory import SERIES, VOLUME
from steradian.storage.db.tables import ScanRow
from steradian.storage.state_machines import SETTLED_SCAN_STATES, ReconstructionState

MOST_ROWS = 10_000
"""Most rows of a table of regions, which the job's result has."""
MOST_PANELS = 36
"""Most volumes of a figure, as in steradian.reconstructions.volumes.panels."""


class ResourceEstimate(NamedTuple):
    """Resource estimate of a job: upper bound of disk bytes, lower bound of memory bytes; 0 where unknown."""

    disk: int
    memory: int = 0


def check_reconstruction(services: ServiceContainer, wanted: ReconstructionRequest) -> ScanRow:
    """Reject reconstructions that cannot succeed: a running scan without ``follow``, an empty scan, a volume too large.

    Raises
    ------
    NotFound, NotReady, Conflict, InvalidInput
        In that order.
    """
    scan = services.scans.get(wanted.scan_id)
    if scan.state not in SETTLED_SCAN_STATES and not wanted.follow:
        text = f"scan {scan.id} is {scan.state}; it can be reconstructed when it has ended, or live"
        raise NotReady(text)
    if scan.state in SETTLED_SCAN_STATES:
        _check_alines(services, scan)
    check_references(services, scan, wanted)
    return scan


def estimate_resources(services: ServiceContainer, scan: ScanRow, wanted: ReconstructionRequest) -> ResourceEstimate:
    """Return the estimated disk and memory bytes of a reconstruction.

    The volume file contains the voxels, their coarser copies and three projections (float32); a live reconstruction
    holds the last image beside the one that it writes.
    """
    if wanted.unmixing is not None and wanted.reconstruction_id is not None:
        size = volume_size(services, wanted.reconstruction_id, "reconstruction_id")
        maps = len(wanted.unmixing.chromophores) + 3  # saturation, its error, haemoglobin
        one = size // _volumes(services, wanted.reconstruction_id)
        return ResourceEstimate(one * maps, one * (len(wanted.unmixing.chromophores) + maps) // 2)
    *across, deep = expected_shape(services, scan, wanted.parameters)
    disk = file_size((*across, deep)) * (2 if wanted.follow else max(1, len(wanted.series(_frames(services, scan)))))
    return ResourceEstimate(disk, least_memory((*across, deep // wanted.parameters.upsampling), wanted.parameters))


def check_references(services: ServiceContainer, scan: ScanRow, wanted: ReconstructionRequest) -> None:
    """Reject a reconstruction whose volume is too large, or whose frames, mask or series do not fit the scan."""
    if wanted.reconstruction_id is not None:
        _check_unmixing(services, wanted)
        return
    count = max(1, len(wanted.series(_frames(services, scan))))
    _check_size(services, scan, wanted.parameters, count)
    if wanted.through is not None:
        aperture, mask_id = services.masks.get(scan.mask_id).aperture, wanted.through.mask_id
        if abs(services.masks.get(mask_id).aperture - aperture) > 1e-6 * aperture:
            raise InvalidInput("through.mask_id", mask_id, f"a mask of the scan's aperture, {aperture:g} m")


def check_job(services: ServiceContainer, wanted: WorkRequest) -> ResourceEstimate:
    """Reject jobs of the other kinds that cannot succeed; return the estimated resources of accepted jobs.

    Raises
    ------
    NotFound, NotReady, Conflict, InvalidInput
        In that order.
    """
    match wanted:
        case SoundSpeedRequest():
            _check_size(services, _scan_with_data(services, wanted.scan_id), wanted.parameters)
        case QualityRequest():
            _check_pair(services, wanted)
        case WidthRequest():
            _check_width(services, wanted)
        case ExportRequest(scan_id=str(scan_id)):
            scan, found = _scan_with_data(services, scan_id), services.arrays.stat(scan_name(scan_id))
            return ResourceEstimate(scan_bytes(services.plans.get(scan.plan_id)) if found is None else found.size)
        case ExportRequest(reconstruction_id=str(reconstruction_id)):
            size = volume_size(services, reconstruction_id, "reconstruction_id")
            if wanted.index is None:
                return ResourceEstimate(size)
            _check_index(services, reconstruction_id, "index", wanted.index)
            return ResourceEstimate(size // _volumes(services, reconstruction_id))
        case RegionsRequest() | FigureRequest():  # which hold one volume at a time, or two
            size = volume_size(services, wanted.reconstruction_id, "reconstruction_id")
            _check_rows(services, wanted)
            overlay = _check_overlay(services, wanted) if isinstance(wanted, FigureRequest) else 0
            return ResourceEstimate(0, size // _volumes(services, wanted.reconstruction_id) + overlay)
        case ImportRequest():
            uploads = [wanted.upload_id] + ([] if wanted.companion_id is None else [wanted.companion_id])
            return ResourceEstimate(
                sum(_size(services, upload_name(identifier), "upload", identifier) for identifier in uploads)
            )
        case _ if isinstance(identifier := getattr(wanted, "scan_id", None), str):
            _scan_with_data(services, identifier)
    return ResourceEstimate(0)


def frames_of(plan: dict[str, Any]) -> list[float]:
    """Return the excitation wavelength of each frame in m; 0 if the plan does not change the laser's wavelength."""
    return [value for value in plan.get("excitation") or (0.0,) for _ in range(plan.get("frames", 1))]


def volume_size(services: ServiceContainer, reconstruction_id: str, field: str) -> int:
    """Return the size in bytes of a reconstruction's volume file.

    Raises
    ------
    NotFound, NotReady, Conflict
        When there is no such reconstruction, or it has no volume yet, or it ended without one.
    InvalidInput
        When the volume is larger than a job may read.
    """
    job = services.ledger.reconstruction(reconstruction_id)
    if not job.is_over:
        raise NotReady(f"{field} {reconstruction_id} is {job.state}; its volume can be used when it has succeeded")
    if job.state is not ReconstructionState.SUCCEEDED:
        raise Conflict(f"{field} {reconstruction_id} has {job.state} and left no volume")
    count = len(job.result.get("frames") or ())
    name = SERIES if count else VOLUME
    size = _size(services, result_name(reconstruction_id, name), "volume of", reconstruction_id)
    if size // max(1, count) > 2 * services.settings.max_volume_bytes:
        raise InvalidInput(field, reconstruction_id, f"a volume of at most {services.settings.max_volume_bytes} bytes")
    return size


def _size(services: ServiceContainer, name: str, what: str, identifier: str) -> int:
    found = services.arrays.stat(name)
    if found is None:
        raise NotFound(what, identifier)
    return found.size


def _check_alines(services: ServiceContainer, scan: ScanRow) -> None:
    """Reject a scan without A-lines; raises :class:`Conflict`."""
    is_there = services.nodes.is_remote(scan.scanner_id) or services.arrays.stat(scan_name(scan.id)) is not None
    if not is_there or not (scan.summary or {}).get("stored", scan.done):
        raise Conflict(f"scan {scan.id} is {scan.state} and holds no A-lines")


def _check_rows(services: ServiceContainer, wanted: RegionsRequest | FigureRequest) -> None:
    """Reject a table or a page of too many volumes; raises :class:`InvalidInput`."""
    count = _volumes(services, wanted.reconstruction_id)
    if isinstance(wanted, RegionsRequest) and count * len(wanted.regions) > MOST_ROWS:
        told = f"{len(wanted.regions)} in {count} volumes"
        raise InvalidInput("regions", told, f"at most {MOST_ROWS} rows in one job")
    if isinstance(wanted, FigureRequest):
        rows, axes = len(wanted.indices or ()) or count, len(wanted.axes or (wanted.axis,))
        if wanted.format != "gif" and rows * axes > MOST_PANELS:
            given = "missing" if wanted.indices is None else f"{rows} volumes"
            raise InvalidInput("indices", given, f"at most {MOST_PANELS // axes} of the {count} volumes in a figure")
        if wrong := [index for index in wanted.indices or () if not 0 <= index < count]:
            raise InvalidInput("indices", wrong[0], f"0 to {count - 1}")


def _check_overlay(services: ServiceContainer, wanted: FigureRequest) -> int:
    """Return the bytes of a figure's overlay, 0 without one; raises :class:`InvalidInput` unless it is drawable."""
    if wanted.overlay is None:
        return 0
    identifier = wanted.overlay.reconstruction_id
    size = volume_size(services, identifier, "overlay.reconstruction_id")
    _check_index(services, identifier, "overlay.index", wanted.overlay.index)
    shapes = [services.ledger.status(each).result.get("shape", []) for each in (wanted.reconstruction_id, identifier)]
    if len(shapes[0]) != len(shapes[1]):
        raise InvalidInput("overlay.reconstruction_id", identifier, f"an image of {len(shapes[0])} dimensions")
    return size // _volumes(services, identifier)


def _volumes(services: ServiceContainer, reconstruction_id: str) -> int:
    """Return the number of volumes of a series; 1 of a single volume."""
    return len(services.ledger.status(reconstruction_id).result.get("frames") or [0])


def _frames(services: ServiceContainer, scan: ScanRow) -> list[Frame]:
    lights = frames_of(services.plans.get(scan.plan_id).parameters)
    return [Frame(number, light, 0) for number, light in enumerate(lights)]


def _check_unmixing(services: ServiceContainer, wanted: ReconstructionRequest) -> None:
    """Reject an unmixing unless it is of a series of the scan with enough wavelengths."""
    identifier, options = wanted.reconstruction_id or "", wanted.unmixing
    volume_size(services, identifier, "reconstruction_id")
    job = services.ledger.reconstruction(identifier)
    if job.scan_id != wanted.scan_id:
        raise InvalidInput("scan_id", wanted.scan_id, f"that of the series, {job.scan_id}")
    lights = {frame.get("excitation_m") for frame in job.result.get("frames") or ()} - {None, 0.0}
    needed = len(options.chromophores) if options else 1
    if options and options.fluence.model == "fit":
        needed += 1  # what is left over tells the tissue
    if len(lights) < needed:
        told = f"{identifier}, {len(lights)} wavelengths"
        raise InvalidInput("reconstruction_id", told, f"a series of at least {needed} stated wavelengths")


def _check_size(
    services: ServiceContainer, scan: ScanRow, parameters: ReconstructionParameters, count: int = 1
) -> None:
    """Reject a volume that is too large, or ``count`` large ones unasked; raises :class:`InvalidInput`."""
    shape = expected_shape(services, scan, parameters)
    size, limit = 4 * math.prod(shape), services.settings.max_volume_bytes
    if size > limit:
        field, value = "parameters.modes", str(shape[0] // parameters.upsampling)
        if shape[-1] > parameters.upsampling * services.plans.get(scan.plan_id).parameters["samples"]:
            field, value = "parameters.depth_range", str(parameters.depth_range)
        raise InvalidInput(field, value, f"a volume of at most {limit} bytes, not {size}")
    if count * size > LARGE and parameters.modes is None:
        modes = shape[0] // parameters.upsampling
        voxel = 1e6 * services.masks.get(scan.mask_id).aperture / modes
        raise InvalidInput(
            "parameters.modes",
            "missing",
            f"stated for a file above 1 GB: {modes} (voxels of {voxel:.4g} µm) make {1e-9 * count * size:.3g} GB"
            + (f" of {count} volumes" if count > 1 else ""),
        )


def _scan_with_data(services: ServiceContainer, scan_id: str) -> ScanRow:
    scan = services.scans.get(scan_id)
    if scan.state not in SETTLED_SCAN_STATES:
        raise NotReady(f"scan {scan_id} is {scan.state}; it can be used when it has ended")
    _check_alines(services, scan)
    return scan


def _check_width(services: ServiceContainer, wanted: WidthRequest) -> None:
    job = services.ledger.reconstruction(wanted.reconstruction_id)
    if job.scan_id != wanted.scan_id:
        raise InvalidInput("scan_id", wanted.scan_id, f"the reconstruction's, {job.scan_id}")
    if job.kind == "what-if":
        raise InvalidInput("reconstruction_id", wanted.reconstruction_id, "one of all A-lines, no what-if")
    scan = _scan_with_data(services, wanted.scan_id)
    if services.masks.is_line(scan.mask_id):
        raise InvalidInput("reconstruction_id", wanted.reconstruction_id, "one of a plane of sensors, not of a line")
    volume_size(services, wanted.reconstruction_id, "reconstruction_id")
    _check_index(services, wanted.reconstruction_id, "index", wanted.index)


def _check_index(services: ServiceContainer, reconstruction_id: str, field: str, index: int | None) -> None:
    """Reject an index that the series does not have, or none of a series; raises :class:`InvalidInput`."""
    count = _volumes(services, reconstruction_id)
    is_series = bool(services.ledger.status(reconstruction_id).result.get("frames"))
    if (index is None and is_series) or (index or 0) >= count:
        value = "missing" if index is None else index
        raise InvalidInput(field, value, f"0 to {count - 1}: which volume of {reconstruction_id}")


def _check_pair(services: ServiceContainer, wanted: QualityRequest) -> None:
    shapes = []
    indices = {
        "reconstruction_id": ("index", wanted.index),
        "reference_id": ("reference_index", wanted.reference_index),
    }
    for field, identifier in (("reconstruction_id", wanted.reconstruction_id), ("reference_id", wanted.reference_id)):
        volume_size(services, identifier, field)
        _check_index(services, identifier, *indices[field])
        shapes.append(list(services.ledger.status(identifier).result.get("shape", [])))
    if all(shapes) and shapes[0] != shapes[1]:
        raise InvalidInput("reference_id", f"{wanted.reference_id}, {shapes[1]} voxels", f"one of {shapes[0]} voxels")
