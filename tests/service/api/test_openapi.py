"""The document is what is committed, complete, and true of every answer."""

import json
import re
from pathlib import Path

import httpx
import pytest

from steradian.api.app import create_app
from steradian.settings import Settings

COMMITTED = Path(__file__).parents[3] / "docs" / "openapi.json"


@pytest.fixture(scope="module")
def document(tmp_path_factory):
    folder = tmp_path_factory.mktemp("document")
    (folder / "run").mkdir()
    app = create_app(Settings.create(data=folder))
    try:
        yield app.openapi()
    finally:
        app.state.services.close()


def test_the_api_changes_only_with_its_committed_document(document):
    """After a change on purpose: python -m steradian.api.documents > docs/openapi.json."""
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


def has_example(document, schema):
    for part in [schema, *schema.get("anyOf", [])]:
        if "$ref" in part:
            part = document["components"]["schemas"][part["$ref"].rpartition("/")[2]]
        if "examples" in part:
            return True
    return False


def test_the_page_for_people_loads_nothing_from_elsewhere(server, document):
    page = httpx.get(f"{server.url}/docs")
    assert page.headers["content-type"].startswith("text/html")
    assert not re.search(r"(src|href)=\"(https?:)?//|<script|@import|url\(", page.text)
    for path in document["paths"]:
        assert path in page.text


def test_the_bare_address_points_to_the_documentation(server):
    """Whoever opens the address that the service prints finds the way: a browser is led to the page."""
    with httpx.Client(base_url=server.url, timeout=90) as client:
        answer = client.get("/")
        assert answer.status_code == 200
        for name in ("docs", "openapi", "api"):
            assert client.get(answer.json()[name]).status_code == 200
        led = client.get("/", headers={"accept": "text/html,application/xhtml+xml"}, follow_redirects=False)
        assert led.is_redirect
        assert client.get(led.headers["location"]).headers["content-type"].startswith("text/html")
