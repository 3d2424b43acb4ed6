"""Whatever is sent, the service answers as its document says: generated requests against a real process."""

import json
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings

from .conftest import free_scanner

CHECKED = [
    "not_a_server_error",
    "status_code_conformance",
    "content_type_conformance",
    "response_schema_conformance",
    "response_headers_conformance",
]
DOCUMENT = json.loads((Path(__file__).parents[3] / "docs" / "openapi.json").read_text())
NAMES = [
    f"{method.upper()} {path}"
    for path, operations in DOCUMENT["paths"].items()
    for method in operations.keys() & {"get", "head", "post", "put", "patch", "delete", "options"}
    if not path.endswith("/events")  # it does not end; tests of its own
]


@pytest.fixture(scope="module")
def operations():
    import schemathesis  # takes seconds, of every worker if it stood above

    found = [operation.ok() for operation in schemathesis.openapi.from_dict(DOCUMENT).get_all_operations()]
    return {f"{operation.method.upper()} {operation.path}": operation for operation in found}


@pytest.fixture(autouse=True)
def free(http):
    """Undo what a generated request of the test before did."""
    free_scanner(http)


@pytest.fixture
def existing(http, free, mask, plan, scan, scan_with_alines):
    """Identifiers that lead somewhere: generated ones hardly ever do."""
    job = scan_with_alines["reconstruction"]
    return {
        "mask_id": mask["id"],
        "plan_id": plan["id"],
        "scan_id": scan["id"],
        "scanner_id": "scanner-0",
        "reconstruction_id": job["id"],
        "job_id": job["id"],
        "upload_id": http.post("/uploads", content=b"x").json()["id"],
    }


@pytest.mark.parametrize("examples", [1, pytest.param(10, marks=pytest.mark.long)])
@pytest.mark.parametrize("name", sorted(NAMES))
def test_every_answer_is_as_documented(server, fault_clerk, existing, operations, name, examples):
    from schemathesis.checks import CHECKS

    checked = [check for check in CHECKED if not (name.endswith("/readyz") and check == "not_a_server_error")]

    @settings(
        max_examples=examples,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(case=operations[name].as_strategy())
    def check(case):
        if case.path_parameters and len(str(case.path_parameters)) % 2:
            case.path_parameters |= {key: existing[key] for key in case.path_parameters if key in existing}
        answer = case.call(base_url=server.url, timeout=250)
        # what takes more than a processor's two minutes is refused as documented, with a 503
        too_much = answer.status_code == 503 and answer.json().get("code") == "too-expensive"
        wanted = [each for each in checked if not (too_much and each == "not_a_server_error")]
        case.validate_response(answer, checks=CHECKS.get_by_names(wanted))

    check()
