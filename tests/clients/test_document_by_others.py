"""The committed document in the eyes of others' tools: a linter finds nothing, a comparison no break of a promise."""

import gzip
import json
from pathlib import Path

import pytest

pytestmark = [pytest.mark.long, pytest.mark.timeout(400)]
COMMITTED = Path(__file__).parents[2] / "docs" / "openapi.json"
ACCEPTED = Path(__file__).parent / "tools" / "accepted.json.gz"
"""The document that clients may rely on, the last release's: ``gzip -9nc docs/openapi.json >`` it with each release."""
WARNINGS = {
    ("operation-4xx-response", "#/paths/~1healthz/get/responses"): "takes nothing that could be refused",
    ("operation-4xx-response", "#/paths/~1readyz/get/responses"): "likewise; it may say 503",
}
"""What the linter may warn of, and why it stays."""
_JOB = "#/paths/~1api~1v1~1jobs/get/responses/200/content/application~1json/schema/properties/items/items/properties"
BREAKS: dict[tuple[str, str], str] = {
    ("schema-combinator-changed", f"{_JOB}/result/anyOf/6"): "results of jobs of a new kind, regions",
}
"""What may break clients of the accepted document, (rule, place), and why; emptied when the next one is accepted."""
ADDITIONS = {"enum-values-added": "a client has to expect values of answers that it does not know, like fields"}
"""What the comparison takes for a break and we for an addition."""


def test_the_linter_finds_no_error_and_no_warning_without_a_reason(tools):
    told = json.loads(tools.ask("redocly", "lint", "--format=json", "--extends=recommended", COMMITTED).stdout)
    found = {(one["ruleId"], one["location"][0]["pointer"]): one["severity"] for one in told["problems"]}
    assert [where for where, severity in found.items() if severity == "error"] == []
    assert found.keys() == WARNINGS.keys()


def breaks(tools, old, new):
    """Rules and places of the changes that break clients of the old document."""
    told = json.loads(tools.ask("redocly", "diff", "--format=json", "--fail-on=none", old, new).stdout)
    changes = [one for one in told["changes"] if one["impact"] == "major"]
    found = {(verdict["ruleId"], one["path"]) for one in changes for verdict in one["verdicts"]}
    return {(rule, place) for rule, place in found if rule not in ADDITIONS}


def test_no_client_of_the_accepted_document_is_broken(tools, tmp_path):
    (tmp_path / "accepted.json").write_bytes(gzip.decompress(ACCEPTED.read_bytes()))
    assert breaks(tools, tmp_path / "accepted.json", COMMITTED) == BREAKS.keys()


SCANS = "/api/v1/scans"
QUERY = {"name": "colour", "in": "query", "description": "A colour", "schema": {"type": "string"}}


def drop_address(document):
    del document["paths"][f"{SCANS}/{{scan_id}}"]


def drop_method(document):
    del document["paths"][SCANS]["post"]


def rename(document):
    document["paths"][SCANS]["get"]["operationId"] = "all_scans"


def demand_parameter(document):
    document["paths"][SCANS]["get"]["parameters"].append(QUERY | {"required": True})


def demand_field(document):
    document["components"]["schemas"]["ScanRequest"]["required"].append("labels")


def drop_field(document):
    del document["components"]["schemas"]["ScanView"]["properties"]["state"]


def take_less(document):
    document["components"]["schemas"]["ScanRequest"]["properties"]["plan_id"]["maxLength"] = 8


def drop_format(document):
    del document["paths"][f"{SCANS}/{{scan_id}}/alines"]["get"]["responses"]["200"]["content"]["application/x-npy"]


@pytest.mark.parametrize(
    "change",
    [drop_address, drop_method, rename, demand_parameter, demand_field, drop_field, take_less, drop_format],
    ids=lambda change: change.__name__,
)
def test_openapi_diff_breaking_change_is_detected(tools, tmp_path, change):
    document = json.loads(COMMITTED.read_text())
    change(document)
    (tmp_path / "changed.json").write_text(json.dumps(document))
    assert breaks(tools, COMMITTED, tmp_path / "changed.json")


def test_openapi_diff_additive_change_is_not_breaking(tools, tmp_path):
    document = json.loads(COMMITTED.read_text())
    paths, schemas = document["paths"], document["components"]["schemas"]
    paths[f"{SCANS}/{{scan_id}}/colour"] = paths[SCANS] | {"get": paths[SCANS]["get"] | {"operationId": "colour_read"}}
    paths[f"{SCANS}/{{scan_id}}/colour"].pop("post")
    paths[SCANS]["get"]["parameters"].append(QUERY)
    schemas["ScanRequest"]["properties"]["colour"] = {"type": "string", "description": "A colour"}
    schemas["ScanState"]["enum"].append("dozing")
    schemas["ScanView"]["properties"]["colour"] = {"type": "string", "description": "A colour"}
    (tmp_path / "changed.json").write_text(json.dumps(document))
    assert breaks(tools, COMMITTED, tmp_path / "changed.json") == set()
