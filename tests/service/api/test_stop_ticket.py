"""Stop tickets: they press the emergency stop after a session has ended, and open nothing else."""

import asyncio
import base64
import json
from datetime import UTC, datetime, timedelta

import httpx
import pytest

from steradian.api.app import create_app
from steradian.api.middleware.authentication import SCOPES
from steradian.core.settings import Settings
from steradian.security.keys import KeyStore, Principal, Scope, Unauthorized
from steradian.security.stop_tickets import LIFETIME, LONGEST, StopTickets, shared_secret, stored_secret
from steradian.storage.db.database import Database, metadata_url
from support.waiting import until

from .conftest import PLAIN, api_of
from .test_no_connection import take_all
from .test_security import NONE

V1 = "/api/v1"
SESSION, EVERY, ONE = f"{V1}/session", f"{V1}/emergency-stop", f"{V1}/scanners/scanner-0/emergency-stop"
FIXED = "k" * 24
SECRET = b"s" * 32
ADA = Principal("key Ada (0123456789ab)", frozenset({Scope.ADMIN}))


@pytest.fixture(scope="module")
def guarded(database, tmp_path_factory):
    often = {"requests_per_second": 1e6, "failed_keys_per_minute": 1e6}
    server = api_of(tmp_path_factory.mktemp("guarded"), require_key=True, api_key=FIXED, **often, **database()).wait()
    server.keys = KeyStore(server.database)
    yield server
    server.close()


@pytest.fixture
def client(guarded):
    with httpx.Client(base_url=guarded.url, verify=PLAIN, timeout=250) as client:
        yield client


@pytest.fixture(scope="module")
def useless(guarded):
    """The stop ticket of a session whose key has been revoked since; no test changes anything with it."""
    with httpx.Client(base_url=guarded.url, verify=PLAIN, timeout=250) as client:
        key = guarded.keys.create("bench", [Scope.READ])
        ticket = client.post(SESSION, headers={"Authorization": f"Bearer {key}"}).json()["stop_ticket"]
    guarded.keys.revoke(key.split("_")[1])
    return ticket


@pytest.fixture
def revoked(guarded, client):
    """The stop ticket of a session whose key has been revoked since, and the name of the key's principal."""
    key = guarded.keys.create("bench", [Scope.READ])
    told = client.post(SESSION, headers={"Authorization": f"Bearer {key}"}).json()
    client.cookies.clear()
    guarded.keys.revoke(key.split("_")[1])
    yield told["stop_ticket"], told["principal"]
    client.delete(ONE, headers={"Authorization": f"Bearer {FIXED}"})


@pytest.mark.parametrize("path", [EVERY, ONE])
def test_stop_ticket_after_revocation_presses_the_stop_under_the_name_of_its_key(client, revoked, path):
    ticket, name = revoked
    answer = client.post(path, headers={"X-Stop-Ticket": ticket}, json={"reason": "smoke"})
    assert answer.status_code == 202, answer.text
    told = answer.json()["items"][0] if path == EVERY else answer.json()
    assert told["emergency_stop"]["by"] == f"{name} (stop ticket)"


def test_stop_ticket_lets_a_page_ask_whether_it_can_stop(client, revoked):
    ticket, name = revoked
    assert client.get(EVERY).status_code == 401
    answer = client.get(EVERY, headers={"X-Stop-Ticket": ticket})
    assert (answer.status_code, answer.json()) == (200, {"by": f"{name} (stop ticket)"})
    assert client.get(EVERY, headers={"Authorization": f"Bearer {FIXED}"}).json() == {"by": "settings"}


@pytest.mark.parametrize(("method", "path"), sorted(SCOPES, key=str))
def test_stop_ticket_on_any_other_route_is_refused(client, useless, method, path):
    if (method, path.replace("{scanner_id}", "scanner-0")) in {("GET", EVERY), ("POST", EVERY), ("POST", ONE)}:
        return
    here = path.format(**NONE | {"scanner_id": "scanner-0"})
    answer = client.request(method, here, headers={"X-Stop-Ticket": useless})
    assert (answer.status_code, answer.json()["code"]) == (401, "unauthorized")
    for way in ({"Authorization": f"Bearer {useless}"}, {"Cookie": f"steradian_session={useless}"}):
        assert client.request(method, here, headers=way).status_code == 401


def test_stop_ticket_beside_a_valid_session_is_not_mentioned_in_the_record(guarded, client):
    told = client.post(SESSION, headers={"Authorization": f"Bearer {FIXED}"}).json()
    page = {"Origin": guarded.url, "X-CSRF-Token": told["csrf_token"], "X-Stop-Ticket": told["stop_ticket"]}

    def pressed_by():
        return client.post(ONE, headers=page).json()["emergency_stop"]["by"]

    until(lambda: pressed_by() == "settings")  # the session is known without the database after a second
    client.delete(ONE, headers=page)


def test_stop_ticket_without_a_connection_to_the_database_presses_the_stop(tmp_path):
    """Also beside a cookie whose session nobody has looked at: whether it is valid only the database knows."""
    settings = Settings.create(data=tmp_path, require_key=True)
    database = Database(metadata_url(settings))
    database.migrate()
    database.close()
    app = create_app(settings)
    services = app.state.services
    headers = {"X-Stop-Ticket": services.stop_tickets.issue(ADA), "Cookie": "steradian_session=unknown"}

    async def press(headers):
        transport = httpx.ASGITransport(app=app)
        async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1", timeout=60) as http:
            return await http.post(ONE, headers=headers)

    services.database.engine.pool._timeout = 0.2  # seconds
    with take_all(services):
        assert asyncio.run(press({"Cookie": "steradian_session=unknown"})).status_code == 503
        answer = asyncio.run(press(headers))
    services.process_pool.close()
    services.close()
    assert answer.status_code == 202, answer.text
    assert answer.json()["emergency_stop"]["by"] == f"{ADA.name} (stop ticket)"


@pytest.mark.parametrize("wrong", ["", "x", "x.y", "é.ü", "a.b.c", "a" * (LONGEST + 1), "otherwise signed", "ended"])
def test_stop_ticket_that_is_none_is_refused(guarded, client, wrong):
    if wrong == "otherwise signed":
        wrong = StopTickets(SECRET).issue(ADA)
    elif wrong == "ended":
        secret = stored_secret(guarded.data.stop_secret)
        wrong = StopTickets(secret, lambda: datetime.now(UTC) - LIFETIME - timedelta(seconds=2)).issue(ADA)
    answer = client.post(ONE, headers={"X-Stop-Ticket": wrong.encode("latin-1", "replace")})
    assert (answer.status_code, answer.json()["code"]) == (401, "unauthorized")


def test_stop_ticket_from_another_origin_cannot_be_sent(guarded, client):
    """A page of another origin would have to ask first, and no answer allows the header."""
    asks = {"Origin": "https://evil.example", "Access-Control-Request-Method": "POST"}
    asks |= {"Access-Control-Request-Headers": "x-stop-ticket"}
    answer = client.options(ONE, headers=asks)
    allowed = answer.headers.get("access-control-allow-headers", "")
    assert "x-stop-ticket" not in allowed.lower()
    assert allowed != "*"


def test_stop_ticket_is_not_given_where_no_key_is_needed(http):
    assert http.get("/session").json()["stop_ticket"] is None
    assert http.get("/emergency-stop").json() == {"by": "local"}


def test_stop_ticket_contains_only_name_and_expiry():
    now = datetime(2026, 1, 1, tzinfo=UTC)
    ticket = StopTickets(SECRET, lambda: now).issue(ADA)
    said = ticket.partition(".")[0]
    decoded = json.loads(base64.urlsafe_b64decode(f"{said}=="))
    assert decoded == [ADA.name, int((now + LIFETIME).timestamp())]
    for later, valid in ((LIFETIME - timedelta(seconds=1), True), (LIFETIME, False)):
        tickets = StopTickets(SECRET, lambda: now + later)  # noqa: B023 - it is used in this turn
        if valid:
            assert tickets.check(ticket) == Principal(f"{ADA.name} (stop ticket)", frozenset())
        else:
            with pytest.raises(Unauthorized):
                tickets.check(ticket)


def test_stop_ticket_of_a_long_name_fits_the_column_that_records_it():
    name = StopTickets(SECRET).check(StopTickets(SECRET).issue(Principal("n" * 119, frozenset()))).name
    assert len(name) <= 120
    assert name.endswith("… (stop ticket)")


def test_stop_ticket_secret_is_for_its_user_alone_and_outlasts_a_restart(tmp_path):
    path = tmp_path / "emergency-stop" / "ticket-secret"
    secret = stored_secret(path)
    assert (path.stat().st_mode & 0o777, len(secret)) == (0o600, 32)
    assert stored_secret(path) == secret
    path.write_bytes(b"half")
    assert len(stored_secret(path)) == 32, "a damaged file is replaced"


@pytest.mark.long
def test_stop_ticket_of_one_api_node_is_good_on_another(tmp_path):
    """The nodes of a cluster have their key from the secret that they share, and nothing in a folder."""
    shared = "n" * 32
    nodes = [api_of(tmp_path / name, require_key=True, api_key=FIXED, node_secret=shared) for name in ("a", "b")]
    try:
        first, second = (node.wait().url for node in nodes)
        ticket = httpx.get(first + SESSION, headers={"Authorization": f"Bearer {FIXED}"}, timeout=60).json()[
            "stop_ticket"
        ]
        assert httpx.get(second + EVERY, headers={"X-Stop-Ticket": ticket}, timeout=60).status_code == 200
        assert not any(node.data.stop_secret.exists() for node in nodes)
    finally:
        for node in nodes:
            node.close()
    assert shared_secret(shared) != shared_secret("m" * 32)
