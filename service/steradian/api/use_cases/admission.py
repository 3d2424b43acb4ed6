"""Admission checks before jobs are queued: existence of inputs, size of volumes, estimates of disk and memory."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from steradian.api.errors.handlers import NotReady
from steradian.api.services import ServiceContainer
from steradian.core.exceptions import Conflict, InvalidInput, NotFound
from steradian.imaging.geometry.depth_extent import Extent
from steradian.imaging.medium import Medium
from steradian.jobs.requests import (
    ExportRequest,
    ImportRequest,
    QualityRequest,
    ReconstructionRequest,
    SoundSpeedRequest,
    WidthRequest,
    WorkRequest,
)
from steradian.reconstructions.medium_parameters import build_medium
from steradian.reconstructions.parameters import LARGE, ReconstructionParameters, default_modes
from steradian.reconstructions.volumes.pyramid import file_size
from steradian.scans.frames import Frame
from steradian.storage.blobs.interface import result_name, scan_name, upload_name
from steradian.storage.capacity.reserve import scan_bytes
from steradian.storage.data_dir.job_directory import VOLUME
from steradian.storage.db.tables import ScanRow
from steradian.storage.state_machines import SETTLED_SCAN_STATES, ReconstructionState


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
    *across, deep = _shape(services, scan, wanted.parameters)
    disk = file_size((*across, deep)) * (2 if wanted.follow else 1)
    return ResourceEstimate(disk, _least_memory((*across, deep // wanted.parameters.upsampling), wanted.parameters))


def check_references(services: ServiceContainer, scan: ScanRow, wanted: ReconstructionRequest) -> None:
    """Reject a reconstruction whose volume is too large, or whose frames or what-if mask do not fit the scan."""
    _check_size(services, scan, wanted.parameters)
    lights = frames_of(services.plans.get(scan.plan_id).parameters)
    wanted.frames.pick([Frame(number, light, 0) for number, light in enumerate(lights)])
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
            return ResourceEstimate(volume_size(services, reconstruction_id, "reconstruction_id"))
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
    size = _size(services, result_name(reconstruction_id, VOLUME), "volume of", reconstruction_id)
    if size > 2 * services.settings.max_volume_bytes:
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


def _check_size(services: ServiceContainer, scan: ScanRow, parameters: ReconstructionParameters) -> None:
    """Reject a volume that is too large; raises :class:`InvalidInput`."""
    shape = _shape(services, scan, parameters)
    size, limit = 4 * math.prod(shape), services.settings.max_volume_bytes
    if size > limit:
        field, value = "parameters.modes", str(shape[0] // parameters.upsampling)
        if shape[-1] > parameters.upsampling * services.plans.get(scan.plan_id).parameters["samples"]:
            field, value = "parameters.depth_range", str(parameters.depth_range)
        raise InvalidInput(field, value, f"a volume of at most {limit} bytes, not {size}")
    if size > LARGE and parameters.modes is None:
        modes = shape[0] // parameters.upsampling
        voxel = 1e6 * services.masks.get(scan.mask_id).aperture / modes
        raise InvalidInput(
            "parameters.modes",
            "missing",
            f"stated for a volume above 1 GB: {modes} (voxels of {voxel:.4g} µm) make {1e-9 * size:.3g} GB",
        )


def _shape(services: ServiceContainer, scan: ScanRow, parameters: ReconstructionParameters) -> tuple[int, ...]:
    """Return the voxels of an image along its lateral axes (one for a line of sensors, else two) and in depth."""
    modes = parameters.modes or _default_modes(services, scan.mask_id)
    across = 1 if services.masks.is_line(scan.mask_id) else 2
    deep = _slices(services.plans.get(scan.plan_id).parameters, parameters)
    return (*[modes * parameters.upsampling] * across, deep * parameters.upsampling)


def _default_modes(services: ServiceContainer, mask_id: str) -> int:
    return default_modes(services.masks.default_modes(mask_id), services.masks.get(mask_id).aperture)


def _slices(plan: dict[str, Any], parameters: ReconstructionParameters) -> int:
    """Return the number of depth slices of an image: one a sample, more for a delayed record or a depth range.

    Only the scan file contains the time zero of the record; known here are the requested delay and depth range.
    """
    samples: int = plan["samples"]
    interval, speed = plan.get("sampling_interval"), parameters.sound_speed or plan.get("sound_speed")
    if not interval or (parameters.medium is None and not speed):
        return samples
    if parameters.medium is not None:
        try:
            medium = build_medium(parameters.medium, speed)
        except InvalidInput as error:
            raise InvalidInput(f"parameters.{error.field}", error.value, error.allowed) from error
        return _layered_slices(samples, interval, medium, parameters)
    if parameters.depth_range is None:
        extent = Extent(samples, parameters.conditioning.delay / interval)
        return max(samples, extent.end - extent.first)
    first, last = parameters.depth_range
    return samples if last is None else max(samples, math.ceil((last - (first or 0.0)) / (interval * speed)) + 1)


def _layered_slices(samples: int, interval: float, medium: Medium, parameters: ReconstructionParameters) -> int:
    """Return the number of depth slices of an image of layers, which are a sample of the slowest layer apart."""
    extent = Extent(samples, parameters.conditioning.delay / interval)
    first, last = parameters.depth_range or (None, None)
    begin = medium.depth_at(extent.first * interval) if first is None else first
    end = medium.depth_at(extent.end * interval) if last is None else last
    return max(samples, math.ceil((end - begin) / (interval * medium.slowest)) + (last is not None))


def _least_memory(shape: tuple[int, ...], parameters: ReconstructionParameters) -> int:
    """Return the bytes of the image alone (float32), a lower bound of memory; 0 if its depth is not known yet."""
    is_whole = parameters.depth_range is None and parameters.depth_step is None and parameters.highest_frequency is None
    return 4 * math.prod(shape) if is_whole else 0


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


def _check_pair(services: ServiceContainer, wanted: QualityRequest) -> None:
    shapes = []
    for field, identifier in (("reconstruction_id", wanted.reconstruction_id), ("reference_id", wanted.reference_id)):
        volume_size(services, identifier, field)
        shapes.append(list(services.ledger.status(identifier).result.get("shape", [])))
    if all(shapes) and shapes[0] != shapes[1]:
        raise InvalidInput("reference_id", f"{wanted.reference_id}, {shapes[1]} voxels", f"one of {shapes[0]} voxels")
