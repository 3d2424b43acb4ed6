"""Routes of the HTTP API, each with whether a request may be repeated after a lost response.

A request that never left is always sent again. One whose answer was lost is sent again only where twice does no more
than once: it reads or names an end state, is told apart by its content, or carries an idempotency key. Not so what
could make the laser fire, or lift a stop that was pressed meanwhile.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final
from urllib.parse import quote

V1: Final = "/api/v1"


@dataclass(frozen=True)
class Route:
    """API route: HTTP method and path template.

    Attributes
    ----------
    repeatable
        Whether it may be sent again when the answer was lost, or later when the service is away or busy.
    keyed
        Whether it takes an idempotency key, which makes it repeatable.
    """

    method: str
    template: str
    repeatable: bool = True
    keyed: bool = False

    def path(self, **identifiers: str) -> str:
        """Return the path with the identifiers inserted."""
        return self.template.format_map({name: quote(value, safe="") for name, value in identifiers.items()})


READ_ROOT: Final = Route("GET", V1)
READ_STORAGE: Final = Route("GET", f"{V1}/storage")
HEALTH: Final = Route("GET", "/healthz")
READINESS: Final = Route("GET", "/readyz")
METRICS: Final = Route("GET", "/metrics")

LIST_MASKS: Final = Route("GET", f"{V1}/masks")
CREATE_MASK: Final = Route("POST", f"{V1}/masks")
PREVIEW_MASK: Final = Route("POST", f"{V1}/masks/preview")
READ_MASK: Final = Route("GET", f"{V1}/masks/{{id}}")
DELETE_MASK: Final = Route("DELETE", f"{V1}/masks/{{id}}")
READ_POINTS: Final = Route("GET", f"{V1}/masks/{{id}}/points")
READ_PICTURE: Final = Route("GET", f"{V1}/masks/{{id}}/picture")

LIST_PLANS: Final = Route("GET", f"{V1}/plans")
CREATE_PLAN: Final = Route("POST", f"{V1}/plans")
PREVIEW_PLAN: Final = Route("POST", f"{V1}/plans/preview")
READ_PLAN: Final = Route("GET", f"{V1}/plans/{{id}}")
DELETE_PLAN: Final = Route("DELETE", f"{V1}/plans/{{id}}")

PREVIEW_DESIGN: Final = Route("POST", f"{V1}/designs/preview")
PREVIEW_POINT_SPREAD: Final = Route("POST", f"{V1}/designs/point-spread")
PREVIEW_BUDGET: Final = Route("POST", f"{V1}/designs/budget")

LIST_SCANNERS: Final = Route("GET", f"{V1}/scanners")
READ_SCANNER: Final = Route("GET", f"{V1}/scanners/{{id}}")
RETIRE_SCANNER: Final = Route("DELETE", f"{V1}/scanners/{{id}}")
TAKE_LEASE: Final = Route("PUT", f"{V1}/scanners/{{id}}/lease")
RETURN_LEASE: Final = Route("DELETE", f"{V1}/scanners/{{id}}/lease")
PRESS_STOP: Final = Route("POST", f"{V1}/scanners/{{id}}/emergency-stop")
STOP_ALL: Final = Route("POST", f"{V1}/emergency-stop")
CLEAR_FAULT: Final = Route("POST", f"{V1}/scanners/{{id}}/clear-fault", repeatable=False)
RELEASE_STOP: Final = Route("DELETE", f"{V1}/scanners/{{id}}/emergency-stop", repeatable=False)
RELEASE_NAMED_STOP: Final = Route("DELETE", f"{V1}/scanners/{{id}}/emergency-stop")

LIST_SCANS: Final = Route("GET", f"{V1}/scans")
CREATE_SCAN: Final = Route("POST", f"{V1}/scans", keyed=True)
READ_SCAN: Final = Route("GET", f"{V1}/scans/{{id}}")
CHANGE_SCAN: Final = Route("PATCH", f"{V1}/scans/{{id}}")
DELETE_SCAN: Final = Route("DELETE", f"{V1}/scans/{{id}}")
SET_SCAN_STATE: Final = Route("PUT", f"{V1}/scans/{{id}}/desired-state")
RUN_SCAN: Final = Route("PUT", f"{V1}/scans/{{id}}/desired-state", repeatable=False)
DECIDE_SCAN_STAGE: Final = Route("PUT", f"{V1}/scans/{{id}}/stages/{{number}}")
READ_SCAN_FILE: Final = Route("GET", f"{V1}/scans/{{id}}/file")
READ_SHOTS: Final = Route("GET", f"{V1}/scans/{{id}}/shots")
READ_SIGNALS: Final = Route("GET", f"{V1}/scans/{{id}}/signals")
READ_ALINES: Final = Route("GET", f"{V1}/scans/{{id}}/alines")
READ_LATEST_ALINE: Final = Route("GET", f"{V1}/scans/{{id}}/alines/latest")
READ_COVERAGE: Final = Route("GET", f"{V1}/scans/{{id}}/coverage")

LIST_RECONSTRUCTIONS: Final = Route("GET", f"{V1}/reconstructions")
CREATE_RECONSTRUCTION: Final = Route("POST", f"{V1}/reconstructions", keyed=True)
READ_RECONSTRUCTION: Final = Route("GET", f"{V1}/reconstructions/{{id}}")
CHANGE_RECONSTRUCTION: Final = Route("PATCH", f"{V1}/reconstructions/{{id}}")
DELETE_RECONSTRUCTION: Final = Route("DELETE", f"{V1}/reconstructions/{{id}}")
READ_MIP: Final = Route("GET", f"{V1}/reconstructions/{{id}}/mip")
READ_VOLUME: Final = Route("GET", f"{V1}/reconstructions/{{id}}/volume")
READ_REVISION: Final = Route("GET", f"{V1}/reconstructions/{{id}}/revision")
READ_MEASUREMENTS: Final = Route("GET", f"{V1}/reconstructions/{{id}}/measurements")
SET_MEASUREMENTS: Final = Route("PUT", f"{V1}/reconstructions/{{id}}/measurements")
LIST_QUALITY: Final = Route("GET", f"{V1}/reconstructions/{{id}}/quality")
CREATE_QUALITY: Final = Route("POST", f"{V1}/reconstructions/{{id}}/quality", keyed=True)

LIST_BATCHES: Final = Route("GET", f"{V1}/batches")
CREATE_BATCH: Final = Route("POST", f"{V1}/batches", keyed=True)
READ_BATCH: Final = Route("GET", f"{V1}/batches/{{id}}")
DELETE_BATCH: Final = Route("DELETE", f"{V1}/batches/{{id}}")
WISH_BATCH: Final = Route("PUT", f"{V1}/batches/{{id}}/desired-state")

LIST_JOBS: Final = Route("GET", f"{V1}/jobs")
CREATE_JOB: Final = Route("POST", f"{V1}/jobs", keyed=True)
READ_JOB: Final = Route("GET", f"{V1}/jobs/{{id}}")
CHANGE_JOB: Final = Route("PATCH", f"{V1}/jobs/{{id}}")
DELETE_JOB: Final = Route("DELETE", f"{V1}/jobs/{{id}}")
WISH_JOB: Final = Route("PUT", f"{V1}/jobs/{{id}}/desired-state")
READ_JOB_ATTEMPTS: Final = Route("GET", f"{V1}/jobs/{{id}}/attempts")
READ_JOB_LOG: Final = Route("GET", f"{V1}/jobs/{{id}}/log")
READ_JOB_FILE: Final = Route("GET", f"{V1}/jobs/{{id}}/files/{{name}}")

CREATE_UPLOAD: Final = Route("POST", f"{V1}/uploads")
READ_UPLOAD: Final = Route("GET", f"{V1}/uploads/{{id}}")
APPEND_UPLOAD: Final = Route("PATCH", f"{V1}/uploads/{{id}}", repeatable=False)
"""It goes on where the service says that the upload ends, which is asked anew each time."""
PREVIEW_UPLOAD: Final = Route("POST", f"{V1}/uploads/{{id}}/preview")
DELETE_UPLOAD: Final = Route("DELETE", f"{V1}/uploads/{{id}}")

FOLLOW_EVENTS: Final = Route("GET", f"{V1}/events")
