"""Addresses in answers, where a proxy serves the service below a path."""

import json
import re
import uuid

import httpx
import pytest

from steradian.api.app import create_app
from steradian.api.http.urls import LONGEST
from steradian.core.exceptions import InvalidInput
from steradian.core.settings import OWN_PATHS, Settings

from .conftest import EQUI, PLAIN, api_of

BELOW = "/steradian"
STATED = {"X-Forwarded-Prefix": BELOW, "X-Forwarded-For": "192.0.2.1"}
KEY = "a key for these tests alone"
BEARER = {"Authorization": f"Bearer {KEY}"}


@pytest.fixture(scope="module")
def kept(tmp_path_factory, database):
    """An API with the setting ``root_path``, behind a proxy that leaves the path in what it asks for."""
    api = api_of(tmp_path_factory.mktemp("kept"), root_path=BELOW, api_key=KEY, **database()).wait()
    yield api
    api.close()


@pytest.fixture(scope="module")
def stripped(tmp_path_factory, database):
    """An API without it, behind a proxy that takes the path off and says so in a header."""
    api = api_of(tmp_path_factory.mktemp("stripped"), api_key=KEY, **database()).wait()
    yield api
    api.close()


@pytest.fixture(params=["kept", "stripped", "both"])
def below(request):
    """A client of the service below a path: the setting, with a proxy of either way, or the header."""
    api = request.getfixturevalue("stripped" if request.param == "stripped" else "kept")
    base = f"{api.url}{BELOW}" if request.param == "kept" else api.url
    headers = BEARER | (STATED if request.param == "stripped" else {"X-Forwarded-For": "192.0.2.1"})
    with httpx.Client(base_url=base, headers=headers, verify=PLAIN, timeout=250) as client:
        yield client


def addresses_in(value):
    """All texts of a JSON value that look like an address of this service."""
    if isinstance(value, dict):
        return [one for part in value.values() for one in addresses_in(part)]
    if isinstance(value, list):
        return [one for part in value for one in addresses_in(part)]
    return [value] if isinstance(value, str) and value.startswith("/") else []


def test_links_below_a_path_name_the_path(below):
    answer = below.post("/api/v1/masks", json=EQUI)
    mask = answer.json()
    assert answer.headers["Location"] == mask["links"]["self"] == f"{BELOW}/api/v1/masks/{mask['id']}"
    plan = below.post("/api/v1/plans", json={"mask_id": mask["id"], "samples": 256}).json()
    scan = below.post("/api/v1/scans", json={"plan_id": plan["id"]}, headers={"Idempotency-Key": uuid.uuid4().hex})
    upload = below.post("/api/v1/uploads", content=b"x")
    session = below.post("/api/v1/session")
    shown = [
        below.get(path).json() for path in ("/api/v1", "/api/v1/masks?limit=1", "/api/v1/scanners", "/problems", "/")
    ]
    shown += [plan, scan.json(), upload.json(), below.get("/api/v1/scans/none").json()]
    found = addresses_in(shown) + [each.headers["Location"] for each in (scan, upload, session)]
    assert len(found) > 60
    assert [address for address in found if not address.startswith(f"{BELOW}/")] == []


def test_the_list_of_masks_below_a_path_links_its_next_page_there(below):
    for depth in (3.1e-3, 3.2e-3):
        below.post("/api/v1/masks", json=EQUI | {"depth": depth})
    link = below.get("/api/v1/masks?limit=1").headers["Link"]
    assert link.startswith(f"<{BELOW}/api/v1/masks?limit=1&before=")


def test_the_session_cookie_below_a_path_is_sent_there_alone(below):
    assert f"Path={BELOW}/api/v1;" in below.post("/api/v1/session").headers["Set-Cookie"]
    assert f"Path={BELOW}/api/v1;" in below.delete("/api/v1/session").headers["Set-Cookie"]


def test_the_documents_below_a_path_ask_there(below):
    assert below.get("/openapi.json").json()["servers"][0]["url"] == BELOW
    for page in ("/docs", "/design", "/scans", "/scans/s01jz0000000000000000000000", "/docs/start.js"):
        text = below.get(page, headers={"Accept": "text/html"}).text
        assert re.findall(r'(?:src|href|url)(?:="|: ")(/[^"]*)', text) == [], page


def test_an_address_with_a_slash_too_many_leads_to_the_same_place_below_the_path(below):
    answer = below.get("/api/v1/masks/?limit=1")
    assert (answer.status_code, answer.headers["Location"]) == (307, f"{BELOW}/api/v1/masks?limit=1")


def test_the_path_without_its_slash_leads_to_the_page(kept):
    answer = httpx.get(f"{kept.url}{BELOW}", headers=BEARER, timeout=60)
    assert (answer.status_code, answer.headers["Location"]) == (308, f"{BELOW}/")


def test_an_answer_repeated_below_another_path_has_that_paths_addresses(stripped):
    with httpx.Client(base_url=f"{stripped.url}/api/v1", headers=BEARER, timeout=250) as http:
        mask = http.post("/masks", json=EQUI | {"depth": 3.3e-3}).json()
        plan = http.post("/plans", json={"mask_id": mask["id"], "samples": 256}).json()
        key = {"Idempotency-Key": uuid.uuid4().hex}
        ways = [{"X-Forwarded-Prefix": path} if path else {} for path in ("", "/a", "/b/c", "")]
        answers = [http.post("/scans", json={"plan_id": plan["id"]}, headers=key | way) for way in ways]
        scans = http.get("/scans").json()["items"]
        reads = [http.get("/masks", headers=way).json() for way in ways]
    where = [each.headers["Location"].rpartition("/api/v1/")[0] for each in answers]
    assert where == ["", "/a", "/b/c", ""]
    assert [each.json()["links"]["file"].rpartition("/api/v1/")[0] for each in answers] == where
    assert len({each.json()["id"] for each in answers}) == 1 == sum(one["plan_id"] == plan["id"] for one in scans)
    assert [each["items"][0]["links"]["self"].rpartition("/api/v1/")[0] for each in reads] == where  # none is another's


NO_PATHS = ["//evil.example", "/a//b", "/..", "/a/../b", "/.git", "a", "/a b", '/"><script>', "/a%2fb", "/a\\b", "/é"]
NO_PATHS += ["/a?b", "https://evil.example", "javascript:alert(1)", "/a,/b", "/" + "a" * LONGEST, "/a" * 9]


@pytest.mark.parametrize("stated", NO_PATHS)
def test_a_header_that_is_no_plain_path_is_ignored(stripped, stated):
    sent = BEARER | {"X-Forwarded-Prefix": stated.encode()}
    answer = httpx.get(f"{stripped.url}/api/v1", headers=sent, verify=PLAIN, timeout=60)
    assert answer.json()["links"]["masks"] == "/api/v1/masks"


def test_two_headers_are_ignored(stripped):
    sent = [*BEARER.items(), ("X-Forwarded-Prefix", "/a"), ("X-Forwarded-Prefix", "/b")]
    assert httpx.get(f"{stripped.url}/api/v1", headers=sent, timeout=60).json()["links"]["masks"] == "/api/v1/masks"


def test_a_header_turns_no_address_into_another(stripped):
    """A proxy that keeps somebody from an address by its path must go on doing so."""
    answer = httpx.get(f"{stripped.url}/x/api/v1/masks", headers=BEARER | {"X-Forwarded-Prefix": "/x"}, timeout=60)
    assert answer.status_code == 404


@pytest.mark.parametrize("path", ["steradian", "//a", "/a/../b", "/.a", "/a b", "/a" * 9, "/" + "a" * 200])
def test_a_setting_that_is_no_plain_path_is_refused(tmp_path, path):
    with pytest.raises(InvalidInput, match="root_path"):
        Settings.create(data=tmp_path, root_path=path)


def test_a_setting_that_begins_like_an_address_of_the_service_is_refused(tmp_path):
    for name in OWN_PATHS:
        with pytest.raises(InvalidInput, match="root_path"):
            Settings.create(data=tmp_path, root_path=f"/{name}/x")
    app = create_app(Settings.create(data=tmp_path))
    assert {route.path.split("/")[1] for route in app.state.routes} | {"openapi.json"} - {""} == OWN_PATHS | {""}


def test_without_a_path_all_is_as_it_was(server):
    root = httpx.get(f"{server.url}/api/v1", timeout=60).json()
    assert root["links"]["masks"] == "/api/v1/masks"
    assert json.loads(httpx.get(f"{server.url}/openapi.json", timeout=60).text)["servers"][0]["url"] == "/"
