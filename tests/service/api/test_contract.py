"""Whatever is sent, the service answers as its document says: generated requests against a real process."""

import json
from functools import cached_property
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings

from .conftest import EQUI, free_scanner, make_plan, make_scan, make_scan_with_alines

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


class Existing:
    """Identifiers that lead somewhere, made when they are asked for: generated ones hardly ever do."""

    def __init__(self, server, http):
        self._server, self._http = server, http

    @cached_property
    def mask_id(self):
        return self._http.post("/masks", json=EQUI).json()["id"]

    @cached_property
    def plan_id(self):
        return make_plan(self._http, self.mask_id)["id"]

    @cached_property
    def scan_id(self):
        return make_scan(self._http, self.plan_id).json()["id"]

    @cached_property
    def job_id(self):
        return make_scan_with_alines(self._server, self._http, self.plan_id)["reconstruction"]["id"]

    @cached_property
    def upload_id(self):
        return self._http.post("/uploads", content=b"x").json()["id"]

    @property
    def reconstruction_id(self):
        return self.job_id

    scanner_id = "scanner-0"

    def of(self, name, otherwise):
        """Return the identifier for a parameter, or the generated one where there is no such thing."""
        return getattr(self, name, otherwise) if name.endswith("_id") else otherwise


@pytest.fixture
def existing(server, http, free):
    return Existing(server, http)


MOST = {"POST /api/v1/designs/budget": 2}
"""Examples of what computes images for seconds."""


@pytest.mark.parametrize("examples", [1, pytest.param(10, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("name", sorted(NAMES))
def test_every_answer_is_as_documented(server, fault_clerk, existing, operations, name, examples):
    from schemathesis.checks import CHECKS

    checked = [check for check in CHECKED if not (name.endswith("/readyz") and check == "not_a_server_error")]

    @settings(
        max_examples=min(examples, MOST.get(name, examples)),
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(case=operations[name].as_strategy())
    def check(case):
        if case.path_parameters and len(str(case.path_parameters)) % 2:
            case.path_parameters |= {key: existing.of(key, value) for key, value in case.path_parameters.items()}
        answer = case.call(base_url=server.url, timeout=250)
        # what takes more than a processor's two minutes is refused as documented, with a 503
        too_much = answer.status_code == 503 and answer.json().get("code") == "too-expensive"
        wanted = [each for each in checked if not (too_much and each == "not_a_server_error")]
        case.validate_response(answer, checks=CHECKS.get_by_names(wanted))

    check()
