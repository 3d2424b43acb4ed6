"""Sessions of browsers: a cookie that scripts cannot read, worth its key, and worth nothing to other pages."""

import re
import time
from datetime import UTC, datetime, timedelta

import httpx
import pytest

from steradian.api.middleware.authentication import BURST, WRITE_COST
from steradian.security.keys import KeyStore, Scope, Unauthorized
from steradian.security.sessions import LIFETIME, MOST, SessionStore
from support.waiting import until

from .conftest import api_of

MASK = {"arrangement": "grid", "aperture": 0.011, "count": 3, "interval": 1e-3}
SESSION, MASKS, STOP = "/api/v1/session", "/api/v1/masks", "/api/v1/scanners/scanner-0/emergency-stop"
FIXED = "k" * 24
UNSAFE = [("POST", MASKS), ("POST", STOP), ("DELETE", SESSION), ("PUT", "/api/v1/scanners/scanner-0/lease")]


@pytest.fixture(scope="module")
def guarded(database, tmp_path_factory):
    often = {"requests_per_second": 1e6, "failed_keys_per_minute": 1e6}
    server = api_of(tmp_path_factory.mktemp("guarded"), require_key=True, api_key=FIXED, **often, **database()).wait()
    server.keys = KeyStore(server.database)
    yield server
    server.close()
    assert "steradian_session" not in server.log


class Browser:
    """A page of the service, signed in with a key."""

    def __init__(self, url, key):
        self.http = httpx.Client(base_url=url, timeout=250)
        self.origin = url
        answer = self.http.post(SESSION, headers={"Authorization": f"Bearer {key}"})
        assert answer.status_code == 201
        self.cookie, self.token = answer.headers["set-cookie"], answer.json()["csrf_token"]

    def ask(self, method, path, headers=None, **more):
        """As the browser sends what a script of the page asks for, but for what is said otherwise."""
        own = {"Origin": self.origin, "Sec-Fetch-Site": "same-origin", "X-CSRF-Token": self.token}
        whole = {name: value for name, value in (own | (headers or {})).items() if value is not None}
        return self.http.request(method, path, headers=whole, **more)


@pytest.fixture
def browser(guarded):
    browser = Browser(guarded.url, guarded.keys.create("bench", [Scope.PLAN, Scope.READ, Scope.OPERATE]))
    yield browser
    browser.http.close()


def test_a_cookie_is_as_good_as_its_key_and_no_script_reads_it(guarded, browser):
    assert re.fullmatch(
        r"steradian_session=[\w-]{43}; HttpOnly; Max-Age=43200; Path=/api/v1; SameSite=strict", browser.cookie
    )
    assert browser.ask("POST", MASKS, json=MASK).status_code in {200, 201}
    assert browser.ask("GET", MASKS, {"X-CSRF-Token": None, "Origin": None}).status_code == 200
    told = browser.ask("GET", SESSION).json()
    assert re.fullmatch(r"key bench \([0-9a-f]+\)", told["principal"])
    assert (told["scopes"], told["csrf_token"]) == (["operate", "plan", "read"], browser.token)
    refused = browser.ask("POST", "/api/v1/jobs", json={})
    assert (refused.status_code, refused.json()["code"]) == (403, "forbidden"), "no more than the key allows"
    assert browser.http.cookies["steradian_session"] not in refused.text + str(told)


@pytest.mark.parametrize(
    "said",
    [
        {"X-CSRF-Token": None},
        {"X-CSRF-Token": ""},
        {"X-CSRF-Token": "0" * 64},
        {"X-CSRF-Token": "é"},
        {"Origin": "https://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://localhost:8888", "Sec-Fetch-Site": "same-site"},
        {"Origin": "http://127.0.0.1"},
        {"Origin": None, "Sec-Fetch-Site": None},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"},
        {"Sec-Fetch-Site": "same-site"},
        {"Sec-Fetch-Site": "none"},
        {"Sec-Fetch-Site": "none", "Origin": None},
        {"Content-Type": "application/x-www-form-urlencoded", "X-CSRF-Token": None},
        {"Content-Type": "multipart/form-data; boundary=x", "X-CSRF-Token": None, "Sec-Fetch-Site": "cross-site"},
        {"Content-Type": "text/plain", "X-CSRF-Token": None, "Origin": "null", "Sec-Fetch-Site": "cross-site"},
    ],
    ids=lambda said: "; ".join(f"{name}: {value}" for name, value in said.items()),
)
def test_another_page_changes_nothing_with_the_cookie(browser, said):
    for method, path in UNSAFE:
        headers = {name: value.encode("latin-1") if value else value for name, value in said.items()}
        answer = browser.ask(method, path, headers, content=b"{}")
        assert (answer.status_code, answer.json()["code"]) == (403, "cross-site"), (method, path)
        assert answer.headers["content-type"] == "application/problem+json"
    assert browser.ask("GET", SESSION).json()["csrf_token"] == browser.token, "nor does it sign the user out"


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_another_page_reads_nothing_with_the_cookie(browser, site):
    answer = browser.ask("GET", SESSION, {"Sec-Fetch-Site": site, "Sec-Fetch-Mode": "cors"})
    assert (answer.status_code, answer.json()["code"]) == (403, "cross-site")


@pytest.mark.parametrize("said", [{"Sec-Fetch-Site": None}, {"Origin": None}])
def test_csrf_check_accepts_missing_origin_or_fetch_site_header(browser, said):
    assert browser.ask("POST", MASKS, said, json=MASK).status_code in {200, 201}


def test_behind_a_proxy_with_tls_the_cookie_is_for_tls_and_the_origin_is_the_proxys(guarded):
    forwarded = {"X-Forwarded-Proto": "https", "X-Forwarded-Host": "lab.example"}
    headers = {"Authorization": f"Bearer {FIXED}"} | forwarded
    answer = httpx.post(guarded.url + SESSION, headers=headers, timeout=250)
    assert "; Secure" in answer.headers["set-cookie"]
    secret = answer.headers["set-cookie"].partition(";")[0]
    page = {"Cookie": secret, "X-CSRF-Token": answer.json()["csrf_token"], "Origin": "https://lab.example"} | forwarded
    assert httpx.post(guarded.url + MASKS, json=MASK, headers=page, timeout=250).status_code in {200, 201}


def test_authorization_header_overrides_session_cookie(guarded, browser):
    """No page can make another's browser send it; so it needs no token, and a wrong one is not made up for."""
    nothing = {"X-CSRF-Token": None, "Origin": None, "Sec-Fetch-Site": None}
    good = guarded.keys.create("other", [Scope.PLAN])
    answer = browser.ask("POST", MASKS, nothing | {"Authorization": f"Bearer {good}"}, json=MASK)
    assert answer.status_code in {200, 201}
    for wrong in ("Bearer sk_000000000000_x", "Basic eDp4"):
        refused = browser.ask("GET", MASKS, {"Authorization": wrong})
        assert (refused.status_code, refused.json()["code"]) == (401, "unauthorized")


@pytest.mark.parametrize("how", ["without anything", "with a cookie", "with a wrong key", "with a form"])
def test_a_session_is_opened_with_a_key_alone(guarded, browser, how):
    match how:
        case "with a cookie":
            answer = browser.ask("POST", SESSION)
        case "with a form":
            answer = httpx.post(guarded.url + SESSION, data={"key": FIXED}, timeout=250)
        case _:
            headers = {"Authorization": "Bearer sk_000000000000_x"} if "key" in how else {}
            answer = httpx.post(guarded.url + SESSION, headers=headers, timeout=250)
    assert (answer.status_code, answer.json()["code"]) == (401, "unauthorized")
    assert "set-cookie" not in answer.headers


def test_sign_out_invalidates_session_cookie(guarded, browser):
    stolen = {"Cookie": f"steradian_session={browser.http.cookies['steradian_session']}"}
    assert httpx.get(guarded.url + SESSION, headers=stolen, timeout=250).status_code == 200
    answer = browser.ask("DELETE", SESSION)
    assert answer.status_code == 204
    assert "Max-Age=0" in answer.headers["set-cookie"]
    assert httpx.get(guarded.url + SESSION, headers=stolen, timeout=250).status_code == 401


def test_a_revoked_key_ends_its_sessions(guarded):
    key = guarded.keys.create("gone", [Scope.READ])
    browser = Browser(guarded.url, key)
    assert browser.ask("GET", MASKS).status_code == 200
    guarded.keys.revoke(key.split("_")[1])
    assert browser.ask("GET", MASKS).status_code == 401
    until(lambda: browser.ask("POST", STOP).status_code == 401)  # whose keys hold is looked at now and then for it
    browser.http.close()


def test_the_stop_is_pressed_with_a_cookie_also_while_the_database_is_not_asked(guarded, browser):
    """Whose session it is, is known from the last look: the same whom the key names."""
    sessions = SessionStore(guarded.database, guarded.keys)
    secret = browser.http.cookies["steradian_session"]
    with pytest.raises(Unauthorized):
        sessions.check_cached(secret)
    sessions.remember()
    assert sessions.check_cached(secret) == sessions.check(secret)
    assert browser.ask("POST", STOP).status_code == 202
    assert browser.ask("DELETE", STOP).status_code == 200


@pytest.mark.long
def test_a_session_survives_a_restart_unless_the_settings_name_another_key(tmp_path):
    def started(key):
        return api_of(tmp_path, require_key=True, api_key=key).wait()

    first = started(FIXED)
    browser = Browser(first.url, FIXED)
    cookie = {"Cookie": browser.cookie.partition(";")[0]}
    browser.http.close()
    first.close()
    for key, status in ((FIXED, 200), ("j" * 24, 401)):
        again = started(key)
        try:
            answer = httpx.get(again.url + SESSION, headers=cookie, timeout=250)
            assert answer.status_code == status
            if status == 200:
                assert answer.json()["csrf_token"] == browser.token
        finally:
            again.close()


def test_sessions_end_after_their_time_and_are_bounded_in_number(guarded):
    now = [datetime.now(UTC)]
    keys = KeyStore(guarded.database, clock=lambda: now[0])
    sessions = SessionStore(guarded.database, keys, clock=lambda: now[0])
    principal = keys.check(keys.create("many", [Scope.READ], timedelta(hours=20)))
    opened = []
    for _ in range(MOST + 1):
        now[0] += timedelta(seconds=1)
        opened.append(sessions.open(principal))
    with pytest.raises(Unauthorized):
        sessions.check(opened[0])
    assert sessions.check(opened[1]).principal == principal
    now[0] += LIFETIME - timedelta(seconds=1)
    assert sessions.check(opened[-1]).principal == principal
    now[0] += timedelta(seconds=2)
    with pytest.raises(Unauthorized):
        sessions.check(opened[-1])
    later = sessions.open(principal)
    now[0] += timedelta(hours=9)
    with pytest.raises(Unauthorized, match="key"):
        sessions.check(later)


def test_session_store_keeps_only_hashes(guarded, browser):
    secret, text = browser.http.cookies["steradian_session"], guarded.settings.data
    kept = b"".join(path.read_bytes() for path in text.glob("steradian.sqlite*"))
    assert secret.encode() not in kept
    assert browser.token.encode() not in kept


@pytest.mark.long
def test_a_session_counts_against_its_keys_rate(tmp_path):
    """However long it takes: both together have what the key alone would have."""
    server = api_of(tmp_path, require_key=True, requests_per_second=1).wait()
    try:
        key = KeyStore(server.database).create("script", [Scope.READ])
        begun = time.monotonic()
        browser = Browser(server.url, key)
        script = httpx.Client(base_url=server.url, headers={"Authorization": f"Bearer {key}"}, timeout=250)
        asked = [answer for _ in range(30) for answer in (browser.ask("GET", MASKS), script.get(MASKS))]
        allowed = sum(answer.status_code == 200 for answer in asked)
        assert allowed <= BURST - WRITE_COST + (time.monotonic() - begun), "neither is a way around the other"
        browser.http.close()
        script.close()
    finally:
        server.close()


def test_keyless_service_session_is_local_admin(server, http):
    told = http.get("/session").json()
    nothing = dict.fromkeys(("csrf_token", "expires", "stop_ticket"))
    assert told == {"principal": "local", "scopes": ["admin"]} | nothing
    stale = {"Cookie": "steradian_session=left-over"}
    assert http.post("/masks", json=MASK, headers=stale).status_code in {200, 201}
    assert http.post("/session").status_code == 401
