"""Who may do what, and what is kept of keys; who may not stands in :mod:`attacks`."""

import httpx
import pytest
from fastapi.routing import APIRoute

from steradian.api import app as application
from steradian.api.middleware.authentication import PUBLIC, SCOPES
from steradian.core.exceptions import InvalidInput
from steradian.core.settings import Settings
from steradian.security.bootstrap import require_api_key
from steradian.security.keys import KeyStore, Scope
from steradian.storage.db.database import Database
from support.apis import ApiProcess

from .conftest import api_of

ROUTES = sorted(SCOPES, key=str)
NONE = dict.fromkeys(
    (
        "mask_id",
        "plan_id",
        "scan_id",
        "reconstruction_id",
        "batch_id",
        "scanner_id",
        "job_id",
        "upload_id",
        "name",
        "path",
        "number",
    ),
    "none",
)


class Guarded(ApiProcess):
    """A real API process on an address that others could reach, and keys of every kind."""

    def __init__(self, folder):
        often = {"requests_per_second": 1e6, "failed_keys_per_minute": 1e6}
        super().__init__(folder, host="0.0.0.0", **often)  # noqa: S104
        self.keys = KeyStore(self.database)
        self.of_scope = {scope: self.keys.create(f"of {scope}", [scope]) for scope in Scope}

    def ask(self, http, method, path, key=None, **more):
        headers = {"Authorization": f"Bearer {key}"} if key is not None else {}
        http.cookies.clear()  # a session would speak for it
        with http.stream(method, self.url + path.format(**NONE), headers=headers, **more) as answer:
            if answer.status_code >= 400:
                answer.read()
            assert_is_safe(answer)
            return answer


def assert_is_safe(answer):
    """Whatever an answer is, a browser guesses no type, loads nothing, shows it in no frame and keeps nothing."""
    assert answer.headers["x-content-type-options"] == "nosniff"
    policy = answer.headers["content-security-policy"]
    assert policy.startswith("default-src 'none'; frame-ancestors 'none'")
    rest = policy.replace("script-src 'self'", "") if answer.url.path == "/docs" else policy
    assert "script" not in rest, "but for the page's own files, none is run"
    assert "unsafe" not in policy
    assert answer.headers["referrer-policy"] == "no-referrer"
    assert answer.headers["cross-origin-resource-policy"] == "same-origin"
    caching = answer.headers["cache-control"]
    assert caching in {"no-store", "no-cache"} if answer.status_code >= 400 else "no-" in caching


def secret_of(key):
    """The part behind prefix and identifier; it may hold underscores itself."""
    return key.split("_", 2)[-1]


@pytest.fixture(scope="module")
def guarded(tmp_path_factory):
    guarded = Guarded(tmp_path_factory.mktemp("guarded")).wait()
    yield guarded
    guarded.close()
    for key in guarded.of_scope.values():
        assert secret_of(key) not in guarded.log, "no secret is in the log"


@pytest.fixture(scope="module")
def client():
    with httpx.Client(timeout=250) as client:
        yield client


def routes():
    for module in (*application.ROUTER_MODULES, application.metrics):
        for route in module.router.routes:
            assert isinstance(route, APIRoute)
            yield from ((method, route) for method in route.methods)


def test_every_route_has_scope_and_authorized_route_class():
    assert {(method, route.path_format) for method, route in routes()} == set(SCOPES)
    assert all(type(route).__name__ == "AuthorizedRoute" for _, route in routes())


def test_no_handler_takes_authorisation_from_its_input():
    words = {"scope", "scopes", "principal", "key", "token", "authorization", "api_key", "role", "admin", "ticket"}
    for _, route in routes():
        given = [*route.dependant.query_params, *route.dependant.path_params, *route.dependant.cookie_params]
        for dependency in route.dependant.dependencies:
            given += [*dependency.query_params, *dependency.cookie_params]
        assert not {parameter.name for parameter in given} & words, route.path


@pytest.mark.parametrize(("method", "path"), ROUTES)
def test_a_route_is_open_to_its_scope(guarded, client, method, path):
    need = SCOPES[method, path]
    for scope in Scope if need is PUBLIC else (need, Scope.ADMIN):
        assert guarded.ask(client, method, path, guarded.of_scope[scope]).status_code not in {401, 403, 500}, scope


def test_routes_without_key_return_401(guarded, client):
    for method, path in ROUTES:
        answer = guarded.ask(client, method, path)
        assert (answer.status_code, answer.json()["code"]) == (401, "unauthorized")
        assert answer.headers["www-authenticate"].startswith("Bearer")


@pytest.mark.parametrize("path", ["/", "/docs", "/openapi.json", "/healthz", "/readyz", "/none", "/api/v1/x", "/%00"])
def test_no_answer_leaves_a_browser_room(guarded, client, path):
    assert_is_safe(client.get(guarded.url + path))
    assert_is_safe(client.request("PROPFIND", guarded.url + path))


def test_versioned_response_is_cached_privately_with_revalidation(guarded, client):
    key = {"Authorization": f"Bearer {guarded.of_scope[Scope.READ]}"}
    answer = client.get(f"{guarded.url}/api/v1/scanners/scanner-0", headers=key)
    assert answer.headers["cache-control"] == "private, no-cache"
    same = client.get(
        f"{guarded.url}/api/v1/scanners/scanner-0", headers=key | {"If-None-Match": answer.headers["etag"]}
    )
    assert (same.status_code, same.headers["cache-control"]) == (304, "private, no-cache")


def test_health_is_open_to_anybody(guarded, client):
    assert client.get(f"{guarded.url}/healthz").status_code == 200
    assert client.get(f"{guarded.url}/readyz").status_code == 503


def test_key_store_keeps_only_hashes(guarded):
    text = str([vars(row) for row in guarded.keys.list()])
    assert all(secret_of(key) not in text for key in guarded.of_scope.values())


def test_other_addresses_than_the_loopback_need_a_key_before_the_start(tmp_path):
    database = Database(f"sqlite:///{tmp_path / 'x.sqlite'}")
    database.migrate()
    reached = {"data": tmp_path, "host": "0.0.0.0"}  # noqa: S104
    assert require_api_key(Settings.create(data=tmp_path), database) is None
    with pytest.raises(InvalidInput, match="steradian key create"):
        require_api_key(Settings.create(**reached), database)
    require_api_key(Settings.create(**reached, api_key="a" * 20), database)
    path = tmp_path / "keys" / "admin"
    assert require_api_key(Settings.create(**reached, key_file=path), database) == path
    assert path.stat().st_mode & 0o777 == 0o600
    assert KeyStore(database).check(path.read_text().strip()).scopes == {Scope.ADMIN}
    assert require_api_key(Settings.create(**reached), database) is None, "now there is one"
    database.close()


@pytest.mark.long
def test_a_setting_demands_keys_on_the_loopback_too(tmp_path):
    database = Database(f"sqlite:///{tmp_path / 'x.sqlite'}")
    database.migrate()
    with pytest.raises(InvalidInput, match="steradian key create"):
        require_api_key(Settings.create(data=tmp_path, require_key=True), database)
    database.close()
    key = "k" * 20
    server = api_of(tmp_path / "data", require_key=True, api_key=key)
    try:
        server.wait()
        asked = [
            httpx.get(f"{server.url}/api/v1/masks", headers=h, timeout=250)
            for h in ({}, {"Authorization": f"Bearer {key}"})
        ]
        assert [answer.status_code for answer in asked] == [401, 200]
    finally:
        server.close()
