"""What a job beyond reconstructions must pass before it is queued: nothing is opened here."""

from __future__ import annotations

from steradian.api.problems import NotReady
from steradian.api.requests import Wanted, check_alines, check_parts, existing_volume
from steradian.api.services import Services
from steradian.errors import InvalidInput, NotFound
from steradian.jobs import requests
from steradian.storage.states import SETTLED_SCAN_STATES
from steradian.storage.tables import ScanRow


def check_job(services: Services, wanted: requests.Asked) -> None:
    """Refuse what cannot work.

    Raises
    ------
    NotFound, NotReady, Conflict, InvalidInput
        In that order.
    """
    match wanted:
        case requests.SoundSpeed():
            check_parts(services, _measured(services, wanted.scan_id), Wanted(wanted.parameters))
        case requests.Quality():
            _check_pair(services, wanted)
        case requests.Export(scan_id=str(scan_id)):
            _measured(services, scan_id)
        case requests.Export(reconstruction_id=str(reconstruction_id)):
            existing_volume(services, reconstruction_id, "reconstruction_id")
        case requests.Import():
            for identifier in (wanted.upload_id, wanted.companion_id):
                if identifier is not None and not services.data.upload(identifier).is_file():
                    raise NotFound("upload", identifier)
        case _:
            raise AssertionError(f"no check of {wanted!r}")


def _measured(services: Services, scan_id: str) -> ScanRow:
    scan = services.scans.get(scan_id)
    if scan.state not in SETTLED_SCAN_STATES:
        raise NotReady(f"scan {scan_id} is {scan.state}; it can be used when it is over")
    check_alines(services, scan)
    return scan


def _check_pair(services: Services, wanted: requests.Quality) -> None:
    shapes = []
    for field, identifier in (("reconstruction_id", wanted.reconstruction_id), ("reference_id", wanted.reference_id)):
        existing_volume(services, identifier, field)
        shapes.append(list(services.ledger.status(identifier).result.get("shape", [])))
    if all(shapes) and shapes[0] != shapes[1]:
        raise InvalidInput("reference_id", f"{wanted.reference_id}, {shapes[1]} voxels", f"one of {shapes[0]} voxels")
