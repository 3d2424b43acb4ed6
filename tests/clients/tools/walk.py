"""Mask, plan, scan, reconstruction, slice with the client that openapi-python-client makes: walk.py ADDRESS KEY."""

import json
import sys
import uuid
from http import HTTPStatus
from typing import TypeVar

from httpx import Timeout
from steradian_generated import AuthenticatedClient
from steradian_generated.api.masks import mask_create
from steradian_generated.api.plans import plan_create
from steradian_generated.api.reconstructions import (
    reconstruction_create,
    reconstruction_mip_read,
    reconstruction_read,
    reconstruction_volume_read,
)
from steradian_generated.api.scans import scan_create, scan_read
from steradian_generated.models import (
    EquiSteradian,
    MaskView,
    PlanRequest,
    PlanView,
    Problem,
    ReconstructionMipReadAxis,
    ReconstructionParameters,
    ReconstructionParametersMethod,
    ReconstructionRequest,
    ReconstructionState,
    ReconstructionView,
    ReportView,
    ScanRequest,
    ScanState,
    ScanView,
    VoxelsView,
)

T = TypeVar("T")
WAIT, NEDNER = "wait=100", ReconstructionParametersMethod.NEDNER


def expect(kind: type[T], answer: object) -> T:
    """Return an answer of the kind that is wanted."""
    assert not isinstance(answer, Problem), answer.detail
    assert isinstance(answer, kind), answer
    return answer


address, key = sys.argv[1:]
with AuthenticatedClient(address, key, timeout=Timeout(150), headers={"Accept": "application/json"}) as client:
    arrangement = EquiSteradian(aperture=13.56e-3, depth=3.6e-3, count=60)
    mask = expect(MaskView, mask_create.sync(client=client, body=arrangement))
    plan_request = PlanRequest(mask_id=mask.id, samples=512, pulse_rate=1000)
    plan = expect(PlanView, plan_create.sync(client=client, body=plan_request))
    begin = scan_create.sync(client=client, body=ScanRequest(plan.id), idempotency_key=uuid.uuid4().hex, prefer=WAIT)
    scan = expect(ScanView, begin)
    while scan.ended is None:
        scan = expect(ScanView, scan_read.sync(scan.id, client=client, prefer=WAIT))
    assert scan.state is ScanState.COMPLETE, scan.state

    parameters = ReconstructionParameters(method=NEDNER, modes=32, depth_range=[1e-3, 5e-3])
    request = ReconstructionRequest(scan.id, parameters=parameters)
    job = expect(ReconstructionView, reconstruction_create.sync(client=client, body=request, prefer=WAIT))
    while job.ended is None:
        job = expect(ReconstructionView, reconstruction_read.sync(job.id, client=client, prefer=WAIT))
    assert job.state is ReconstructionState.SUCCEEDED, job.error
    report = expect(ReportView, job.report)
    middle = expect(VoxelsView, reconstruction_volume_read.sync(job.id, client=client, slice_=":,16,:"))
    projection = expect(
        VoxelsView, reconstruction_mip_read.sync(job.id, client=client, axis=ReconstructionMipReadAxis.Z)
    )
    # what an operation answers besides JSON, a generated client leaves to its HTTP client
    mip, png = f"/api/v1/reconstructions/{job.id}/mip", {"Accept": "image/png"}
    picture = client.get_httpx_client().get(mip, params={"axis": "z"}, headers=png).content
    refused = mask_create.sync(client=client, body=EquiSteradian(aperture=-1.0, depth=3.6e-3, count=60))
    assert isinstance(refused, Problem)
    assert refused.status == HTTPStatus.UNPROCESSABLE_ENTITY

size = len(picture)
print(
    json.dumps(
        {"job": job.id, "shape": report.shape, "slice": middle.values, "mip": projection.values, "picture": size}
    )
)
