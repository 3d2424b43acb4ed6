"""Every answer of 400 and above is problem+json that says what is wrong, where, and what would be right."""

import html
from http import HTTPStatus
from pathlib import Path

import httpx
import pytest

import steradian.api.app  # noqa: F401 - what a service imports, with every exception that it can raise
from steradian.api.errors import catalog as problem_kinds
from steradian.api.errors.catalog import PROBLEM_TYPES
from steradian.core.exceptions import SteradianError

LISTED = Path(__file__).parents[3] / "docs" / "problems.md"
JSON = {"Content-Type": "application/json"}
EQUI = {"arrangement": "equi-steradian", "aperture": 13.56e-3, "depth": 3.6e-3, "count": 60}
GRID = {"arrangement": "grid", "aperture": 0.01, "count": 10, "interval": 1e-3}
POINTS = {"arrangement": "points", "aperture": 0.01, "positions": [[0, 0], [1e-3, 0]]}
NONE = "m" + "0" * 24

CASES = [
    # method, path, body, status, code, pointer, words of the detail
    ("GET", "/nope", None, 404, "no-such-route", None, "/api/v1/nope"),
    ("DELETE", "/masks", None, 405, "method-not-allowed", None, "DELETE"),
    ("GET", f"/masks/{NONE}", None, 404, "not-found", None, f"no mask '{NONE}'"),
    ("GET", f"/masks/{NONE}/points", None, 404, "not-found", None, NONE),
    ("GET", "/plans/p1", None, 404, "not-found", None, "no plan 'p1'"),
    ("GET", "/scans/s1", None, 404, "not-found", None, "no scan 's1'"),
    ("GET", "/scans/s1/file", None, 404, "not-found", None, "no scan 's1'"),
    ("GET", "/reconstructions/r1", None, 404, "not-found", None, "no reconstruction 'r1'"),
    ("GET", "/reconstructions/r1/mip", None, 404, "not-found", None, "'r1'"),
    ("GET", "/reconstructions/r1/volume", None, 404, "not-found", None, "'r1'"),
    ("GET", "/jobs/r1/log", None, 404, "not-found", None, "'r1'"),
    ("PUT", "/scans/s1/desired-state", {"state": "stopped"}, 404, "not-found", None, "'s1'"),
    ("PUT", "/jobs/r1/desired-state", {"state": "cancelled"}, 404, "not-found", None, "'r1'"),
    ("POST", "/plans", {"mask_id": NONE}, 404, "not-found", None, NONE),
    ("POST", "/scans", {"plan_id": "p1"}, 404, "not-found", None, "no plan 'p1'"),
    ("POST", "/reconstructions", {"scan_id": "s1"}, 404, "not-found", None, "no scan 's1'"),
    ("POST", "/masks", b"{", 400, "malformed-json", None, "not valid JSON"),
    ("POST", "/masks", None, 422, "invalid-input", "#", "missing"),
    ("POST", "/masks", {}, 422, "invalid-input", "#/arrangement", "equi-steradian, "),
    ("POST", "/masks", [1], 422, "invalid-input", "#", ""),
    ("POST", "/masks", {"arrangement": "spiral"}, 422, "invalid-input", "#/arrangement", "'grid'"),
    ("POST", "/masks", EQUI | {"depth": -1e-3}, 422, "invalid-input", "#/depth", "> 0, at most 1 (m)"),
    ("POST", "/masks", EQUI | {"depth": "deep"}, 422, "invalid-input", "#/depth", "> 0, at most 1 (m)"),
    ("POST", "/masks", EQUI | {"count": 3}, 422, "invalid-input", "#/count", "at least 5"),
    ("POST", "/masks", EQUI | {"count": 5001}, 422, "invalid-input", "#/count", "at most 5000 points"),
    ("POST", "/masks", EQUI | {"colour": 1}, 422, "invalid-input", "#/colour", "not a known field"),
    ("POST", "/masks", b'{"arrangement":"grid","aperture":NaN,"count":2,"interval":1e-3}', 422, "invalid-input",
     "#/aperture", "> 0"),
    ("POST", "/masks", GRID | {"count": 71}, 422, "invalid-input", "#/count", "5041 points; allowed: at most 5000"),
    ("POST", "/masks", GRID | {"interval": 1.0}, 422, "invalid-input", "#/interval", "at most aperture / count"),
    ("POST", "/masks", POINTS | {"positions": [[1, 0]]}, 422, "invalid-input", "#/positions/0", "±5 mm"),
    ("POST", "/masks", POINTS | {"positions": [[0, "a"]]}, 422, "invalid-input", "#/positions", "array of numbers"),
    ("POST", "/masks", POINTS | {"weights": [1]}, 422, "invalid-input", "#/weights", ""),
    ("POST", "/plans", {}, 422, "invalid-input", "#/mask_id", "missing"),
    ("POST", "/plans", {"mask_id": "m", "pulse_rate": 0}, 422, "invalid-input", "#/pulse_rate", "10000 (Hz)"),
    ("POST", "/plans", {"mask_id": "m", "order": "zigzag"}, 422, "invalid-input", "#/order", "'snake'"),
    ("POST", "/reconstructions", {"scan_id": "s", "parameters": {"modes": 1}}, 422, "invalid-input",
     "#/parameters/modes", "at least 2, at most 4096 (modes)"),
    ("POST", "/reconstructions", {"scan_id": "s", "parameters": {"depth_range": [2, 1]}}, 422, "invalid-input",
     "#/parameters/depth_range", "first < last (m)"),
    ("POST", "/reconstructions", {"scan_id": "s", "parameters": {"medium": [{"sound_speed": 15}]}}, 422,
     "invalid-input", "#/parameters/medium/0/sound_speed", "at least 300, at most 12000 (m/s)"),
    ("POST", "/reconstructions", {"scan_id": "s", "parameters": {"medium": [{}, {}]}}, 422, "invalid-input",
     "#/parameters/medium/0/thickness", "at most 1 (m); only the last layer has none"),
    ("POST", "/reconstructions", {"scan_id": "s", "parameters": {"medium": [{}], "sound_speed": 1500}}, 422,
     "invalid-input", "#/parameters/sound_speed", "none beside a medium"),
    ("PUT", "/scans/s1/desired-state", {"state": "exploded"}, 422, "invalid-input", "#/state", "'stopped'"),
    ("GET", "/scans?limit=0", None, 422, "invalid-input", "limit", "at least 1"),
    ("GET", "/reconstructions/r1/mip?axis=w", None, 422, "invalid-input", "axis", "'x', 'y', 'z' or 'depth'"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("method", "path", "body", "status", "code", "pointer", "words"),
    CASES,
    ids=[f"{c[0]} {c[1]} {c[4]}" for c in CASES],
)
def test_bad_input_is_named_with_its_allowed_range(http, method, path, body, status, code, pointer, words):
    sent = {"content": body, "headers": JSON} if isinstance(body, bytes) else {"json": body} if body is not None else {}
    sent["headers"] = sent.get("headers", {}) | ({"Idempotency-Key": "k"} if path == "/scans" else {})
    answer = http.request(method, path, **sent)
    problem = answer.json()
    assert answer.status_code == status
    assert answer.headers["content-type"] == "application/problem+json"
    assert problem["status"] == status
    assert problem["code"] == code
    assert problem["type"] == f"/problems/{code}"
    assert problem["title"] == PROBLEM_TYPES[code].title
    assert problem["title"] != HTTPStatus(status).phrase, "it says what kind of problem it is, not which status"
    assert problem["instance"] == answer.url.path
    assert problem["retryable"] is False
    assert problem["request_id"] == answer.headers["x-request-id"]
    assert words in problem["detail"]
    assert (problem["errors"][0]["pointer"] if problem["errors"] else None) == pointer


def test_several_wrong_fields_are_all_named(http):
    errors = http.post("/masks", json=EQUI | {"depth": -1, "count": 0}).json()["errors"]
    assert [error["pointer"] for error in errors] == ["#/depth", "#/count"]
    assert [error["allowed"] for error in errors] == ["> 0, at most 1 (m)", "at least 5, at most 1e+06 (points)"]


def test_a_form_is_refused_with_the_way_to_send_json(http):
    form = {"Content-Type": "application/x-www-form-urlencoded"}
    answer = http.post("/masks", content=b'{"arrangement":"grid"}', headers=form)
    assert answer.status_code == 415
    assert "--json" in answer.json()["detail"]


@pytest.mark.parametrize("chunked", [False, True])
def test_a_body_above_the_limit_is_refused(http, chunked):
    body = (b" " * 1000 for _ in range(30)) if chunked else b" " * 30_000
    answer = http.post("/masks", content=body, headers=JSON)
    assert (answer.status_code, answer.json()["code"]) == (413, "too-large")
    assert "20000 bytes" in answer.json()["detail"]


def test_the_framework_refuses_nothing_in_its_own_words(server):
    for path in ("/redoc", "/api", "/api/v2/masks", "/%00", "/api/v1/masks/%2e%2e"):
        answer = httpx.get(server.url + path, timeout=250)
        assert answer.status_code == 404
        assert answer.headers["content-type"] == "application/problem+json"


def test_request_id_valid_is_kept_and_invalid_replaced(http):
    assert http.get("/", headers={"X-Request-ID": "my-1"}).headers["x-request-id"] == "my-1"
    assert http.get("/", headers={"X-Request-ID": "a b"}).headers["x-request-id"] != "a b"


def test_internal_error_returns_500_problem_without_internals(server, http, mask):
    with server.database.engine.begin() as connection:
        connection.exec_driver_sql("ALTER TABLE masks RENAME TO hidden")
    try:
        answer = http.get("/masks")
    finally:
        with server.database.engine.begin() as connection:
            connection.exec_driver_sql("ALTER TABLE hidden RENAME TO masks")
    problem = answer.json()
    assert (answer.status_code, problem["code"], problem["retryable"]) == (500, "internal", True)
    assert answer.headers["x-request-id"] == problem["request_id"]
    assert "masks" not in problem["detail"]
    assert http.get("/masks").status_code == 200


@pytest.mark.parametrize("code", PROBLEM_TYPES)
def test_problem_type_url_returns_meaning_and_remedy(server, code):
    """Also for who has no key, and in the form that a program or a browser likes."""
    kind = PROBLEM_TYPES[code]
    told = httpx.get(f"{server.url}/problems/{code}", timeout=250)
    assert told.status_code == 200
    about = {"title": kind.title, "meaning": kind.meaning, "remedy": kind.remedy, "status": kind.status}
    assert told.json() == about | {"type": f"/problems/{code}", "code": code, "retryable": kind.retryable}
    page = httpx.get(f"{server.url}/problems/{code}", headers={"Accept": "text/html, */*;q=0.8"}, timeout=250)
    assert page.headers["content-type"].startswith("text/html")
    assert html.escape(kind.remedy) in page.text


def test_all_kinds_of_problems_are_listed(server):
    listed = httpx.get(f"{server.url}/problems", timeout=250)
    assert [one["code"] for one in listed.json()["items"]] == list(PROBLEM_TYPES)
    missing = httpx.get(f"{server.url}/problems/nope", timeout=250)
    assert (missing.status_code, missing.json()["type"]) == (404, "/problems/not-found")


def test_every_refusal_of_ours_has_a_kind():
    """One that has none would be answered as a failure of the service."""

    def below(kind):
        return {kind}.union(*(below(child) for child in kind.__subclasses__()))

    ours = {kind.code for kind in below(SteradianError) - {SteradianError} if kind.__module__.startswith("steradian.")}
    assert ours - set(PROBLEM_TYPES) == set()


def test_the_list_for_people_is_written_from_the_same_table(capsys):
    """After a change on purpose: python -m steradian.api.errors.catalog > docs/problems.md."""
    problem_kinds.main()
    assert capsys.readouterr().out == LISTED.read_text()


def test_problem_instance_omits_the_query(server):
    """A client may have put a secret into it by mistake."""
    refused = httpx.get(f"{server.url}/api/v1/scans/s1?key=secret", timeout=250)
    assert (refused.status_code >= 400, refused.json()["instance"]) == (True, "/api/v1/scans/s1")
    assert "secret" not in refused.text
