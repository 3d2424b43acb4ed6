"""Pages of other origins: none reads unless a setting names it, and none does more than read."""

import httpx
import pytest

from steradian.core.exceptions import InvalidInput
from steradian.core.settings import Settings

from .conftest import EQUI, api_of

VIEWER, OTHER = "https://viewer.example", "https://evil.example"
PREFLIGHT = {"Access-Control-Request-Method": "GET", "Access-Control-Request-Headers": "range,authorization"}
BY_PAGE = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "cors"}
KEY = "a key for these tests alone"
BEARER = {"Authorization": f"Bearer {KEY}"}


@pytest.fixture(scope="module")
def open_api(tmp_path_factory, database):
    """An API that two viewers may read, and whoever is at its machine without a key."""
    origins = f"{VIEWER}, http://localhost:9000"
    api = api_of(tmp_path_factory.mktemp("open"), api_key=KEY, cors_origins=origins, **database()).wait()
    yield api
    api.close()


@pytest.fixture
def page(open_api):
    """What a page of the viewer asks."""
    with httpx.Client(base_url=f"{open_api.url}/api/v1", headers={"Origin": VIEWER} | BY_PAGE, timeout=250) as page:
        yield page


def allowed(answer):
    return {name: value for name, value in answer.headers.items() if name.startswith("access-control-")}


def test_cors_without_setting_sends_no_access_control_headers(server):
    with httpx.Client(base_url=f"{server.url}/api/v1", headers={"Origin": VIEWER} | BY_PAGE, timeout=60) as page:
        asked = page.options("/masks", headers=PREFLIGHT), page.get("/masks"), page.get("/masks", headers={"Via": "x"})
        assert [answer.status_code for answer in asked] == [403, 403, 401]
        assert [allowed(answer) for answer in asked] == [{}, {}, {}]
        assert asked[1].headers["Cross-Origin-Resource-Policy"] == "same-origin"


def test_a_page_that_is_named_reads(page):
    may = page.options("/masks", headers=PREFLIGHT | {"Access-Control-Request-Private-Network": "true"})
    assert may.status_code == 204
    assert may.headers["Access-Control-Allow-Origin"] == VIEWER
    assert may.headers["Access-Control-Allow-Methods"] == "GET, HEAD"
    assert {"Range", "Authorization"} <= set(may.headers["Access-Control-Allow-Headers"].split(", "))
    assert may.headers["Access-Control-Allow-Private-Network"] == "true"
    for path, status in (("/masks", 200), ("/masks/none", 404), ("", 200)):
        answer = page.get(path)
        assert answer.status_code == status, "a viewer learns by 404 that a piece is empty"
        assert answer.headers["Access-Control-Allow-Origin"] == VIEWER
        assert answer.headers["Cross-Origin-Resource-Policy"] == "cross-origin"
        assert "ETag" in answer.headers["Access-Control-Expose-Headers"].split(", ")
        assert "Origin" in answer.headers["Vary"].split(", ")


def test_cookies_are_never_allowed(open_api, page):
    answers = [page.options("/masks", headers=PREFLIGHT), page.get("/masks")]
    assert [answer.headers.get("Access-Control-Allow-Credentials") for answer in answers] == [None, None]
    cookie = (
        httpx.post(f"{open_api.url}/api/v1/session", headers=BEARER, timeout=60).headers["Set-Cookie"].partition(";")[0]
    )
    refused = page.get("/masks", headers={"Cookie": cookie})
    assert (refused.status_code, refused.json()["code"]) == (403, "cross-site")


def test_a_page_that_is_named_changes_nothing(page):
    for method in ("POST", "PUT", "PATCH", "DELETE"):
        may = page.options("/masks", headers=PREFLIGHT | {"Access-Control-Request-Method": method})
        assert (may.status_code, allowed(may)) == (403, {})
        done = page.request(method, "/masks/none" if method == "DELETE" else "/masks", json=EQUI)
        assert (done.status_code, allowed(done)) == (403, {})
    assert page.post("/emergency-stop").status_code == 403


@pytest.mark.parametrize(
    "origin", [OTHER, f"{VIEWER}.evil.example", f"{VIEWER}:444", "http://viewer.example", "null", "*"]
)
def test_a_page_that_is_not_named_reads_nothing(page, origin):
    for answer in (
        page.options("/masks", headers=PREFLIGHT | {"Origin": origin}),
        page.get("/masks", headers={"Origin": origin}),
    ):
        assert answer.status_code == 403
        assert allowed(answer) == {}


def test_a_picture_in_a_page_that_is_named_is_no_read(page):
    """Where a browser names no origin, the page asks for what it cannot read."""
    del page.headers["Origin"]
    assert page.get("/masks", headers={"Sec-Fetch-Mode": "no-cors"}).status_code == 403


@pytest.mark.long
def test_a_named_page_needs_a_key_where_one_is_needed(tmp_path, database):
    api = api_of(tmp_path, cors_origins=VIEWER, api_key=KEY, require_key=True, **database()).wait()
    try:
        with httpx.Client(base_url=f"{api.url}/api/v1", headers={"Origin": VIEWER} | BY_PAGE, timeout=60) as page:
            answers = [page.get("/masks"), page.get("/masks", headers=BEARER)]
        assert [answer.status_code for answer in answers] == [401, 200]
        assert [answer.headers["Access-Control-Allow-Origin"] for answer in answers] == [VIEWER, VIEWER]
    finally:
        api.close()


@pytest.mark.parametrize(
    "origins", ["*", "null", "viewer.example", f"{VIEWER}/", f"{VIEWER}/page", "ftp://x", f"{VIEWER};{OTHER}"]
)
def test_a_setting_that_is_no_list_of_origins_is_refused(tmp_path, origins):
    with pytest.raises(InvalidInput, match="cors_origins"):
        Settings.create(data=tmp_path, cors_origins=origins)
