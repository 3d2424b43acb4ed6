"""The document is what is committed, complete, and true of every answer."""

import json
import re
from pathlib import Path

import httpx
import pytest

from steradian.api.app import create_app
from steradian.core.settings import Settings

COMMITTED = Path(__file__).parents[3] / "docs" / "openapi.json"
OPERATIONS = {
    "batches": """
        batch_create batch_delete batch_desired_state_set batch_read batches_list
    """,
    "events": """
        events_follow
    """,
    "health": """
        health_read metrics_read readiness_read
    """,
    "designs": """
        budget_preview design_preview point_spread_preview
    """,
    "jobs": """
        job_attempts_read job_change job_create job_delete job_desired_state_set job_file_read job_log_read job_read
        jobs_list upload_append upload_create upload_delete upload_preview upload_read
    """,
    "masks": """
        mask_create mask_delete mask_picture_read mask_points_read mask_preview mask_read masks_list
    """,
    "plans": """
        plan_create plan_delete plan_preview plan_read plans_list
    """,
    "reconstructions": """
        reconstruction_change reconstruction_create reconstruction_delete
        reconstruction_measurements_read reconstruction_measurements_set reconstruction_mip_read
        reconstruction_quality_create reconstruction_quality_list reconstruction_read reconstruction_revision_read
        reconstruction_volume_read reconstruction_zarr_read reconstructions_list
    """,
    "scanners": """
        emergency_stop_press emergency_stop_release emergency_stops_press emergency_stops_read fault_clear
        scanner_lease_return scanner_lease_take scanner_read scanner_retire scanners_list
    """,
    "scans": """
        scan_alines_read scan_change scan_coverage_read scan_create scan_delete scan_desired_state_set
        scan_file_read scan_latest_aline_read scan_read scan_shots_read scan_signals_read scan_stage_set scans_list
    """,
    "service": """
        root_read session_create session_delete session_read storage_read
    """,
}
"""Names by which generators call operations, for each tag: they stay."""


@pytest.fixture(scope="module")
def document(tmp_path_factory):
    folder = tmp_path_factory.mktemp("document")
    (folder / "run").mkdir()
    app = create_app(Settings.create(data=folder))
    try:
        yield app.openapi()
    finally:
        app.state.services.close()


@pytest.mark.long
def test_the_api_changes_only_with_its_committed_document(document):
    """After a change on purpose: python -m steradian.api.export_openapi > docs/openapi.json."""
    assert json.loads(COMMITTED.read_text()) == document


def test_every_operation_has_a_summary_an_example_and_its_refusals(document):
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            where = f"{method} {path}"
            assert operation["summary"], where
            assert operation["description"], where
            for status, answer in operation["responses"].items():
                refuses = status[0] in "45" and (method, path, status) != ("get", "/readyz", "503")
                assert ("application/problem+json" in answer.get("content", {})) is refuses, (where, status)
            for content in operation.get("requestBody", {}).get("content", {}).values():
                assert "examples" in content or has_example(document, content["schema"]), where
            for parameter in operation.get("parameters", []):
                assert parameter.get("description"), (where, parameter["name"])


def test_operations_keep_their_names_and_generators_every_header(document):
    found = [one for operations in document["paths"].values() for one in operations.values()]
    names = {tag: {one["operationId"] for one in found if one["tags"] == [tag]} for tag in OPERATIONS}
    assert names == {tag: set(text.split()) for tag, text in OPERATIONS.items()}
    assert {tag["name"] for tag in document["tags"]} == set(OPERATIONS)
    for operation in found:
        for parameter in operation.get("parameters", ()):
            kinds = {one.get("type") for one in parameter["schema"].get("anyOf", [parameter["schema"]])}
            assert parameter["in"] != "header" or "array" not in kinds, (operation["operationId"], parameter["name"])
            assert "null" not in kinds, "what is left out says nothing; no text of a header or query does"


def test_openapi_links_cover_path_parameters_and_next_operations(document):
    """Tools that walk through an API find real identifiers by these links, and readers what comes next."""
    links = document["components"]["links"]
    paths = {one["operationId"]: path for path, ways in document["paths"].items() for one in ways.values()}
    for name, path in paths.items():
        things = re.findall(r"\{(\w+_id)\}", path)
        assert [*links.get(name, {}).get("parameters", ())] == things, name
    made = document["paths"]["/api/v1/scans"]["post"]["responses"]["201"]["links"]
    assert {"scan_read", "scan_alines_read", "scan_delete", "reconstruction_create", "batch_create"} <= made.keys()


def has_example(document, schema):
    for part in [schema, *schema.get("anyOf", [])]:
        if "$ref" in part:
            part = document["components"]["schemas"][part["$ref"].rpartition("/")[2]]
        if "examples" in part:
            return True
    return False


def test_the_page_for_people_loads_nothing_from_elsewhere(server):
    """All that Swagger UI needs comes from the service, as what it is, and no script stands in the page."""
    page = httpx.get(f"{server.url}/docs", timeout=250)
    assert page.headers["content-type"].startswith("text/html")
    loaded = re.findall(r"(?:src|href)=\"([^\"]*)\"", page.text)
    assert len(loaded) == 5
    assert set(re.findall(r"<script[^>]*>(.*?)</script>", page.text, re.DOTALL)) == {""}
    policy = dict(part.strip().split(" ", 1) for part in page.headers["content-security-policy"].split(";"))
    assert policy["default-src"] == "'none'"
    assert {policy[what] for what in ("script-src", "style-src", "connect-src")} == {"'self'"}
    kinds = {".js": "text/javascript", ".css": "text/css", ".png": "image/png", ".json": "application/json"}
    for address in loaded:
        assert not address.startswith(("/", "http")), "it is found below any path of a proxy"
        address = f"/{address}"
        answer = httpx.get(server.url + address, timeout=250)
        assert (answer.status_code, answer.headers["x-content-type-options"]) == (200, "nosniff")
        assert answer.headers["content-type"].partition(";")[0] == kinds[address[address.rindex(".") :]]
        if "etag" in answer.headers:
            sent = {"If-None-Match": answer.headers["etag"]}
            assert httpx.get(server.url + address, headers=sent, timeout=250).status_code == 304
    assert "SwaggerUIBundle" in httpx.get(f"{server.url}/docs/start.js", timeout=250).text
    for name in ("redoc.standalone.js", "..%2fcore.py", "core.py"):
        assert httpx.get(f"{server.url}/docs/{name}", timeout=250).status_code == 404


def test_the_bare_address_points_to_the_documentation(server):
    """Whoever opens the address that the service prints finds the way: a browser is shown the page."""
    with httpx.Client(base_url=server.url, timeout=250) as client:
        answer = client.get("/")
        assert answer.status_code == 200
        for name in ("docs", "openapi", "api"):
            assert client.get(answer.json()[name]).status_code == 200
        assert client.get("/api/v1/").status_code == 200, "a slash more means the same"
        shown = client.get("/", headers={"accept": "text/html,application/xhtml+xml"})
        assert shown.headers["content-type"].startswith("text/html")
