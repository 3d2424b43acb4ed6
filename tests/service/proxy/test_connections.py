"""Connections between nginx and the service, and answers that are held, streamed or compressed on their way."""

import asyncio
import collections

import httpx
import pytest

from steradian.api.params.dependencies import MAX_WAIT, MAX_WAIT_FORWARDED
from steradian.core.settings import Settings
from support.apis import ApiProcess
from support.nginx import Nginx, by_default, documented, free_port, needed
from support.waiting import until

from .conftest import BEARER, KEY

CLIENTS, IDLE = 100, 1.0
NGINX_KEEPS = 60.0
"""Seconds for which nginx keeps an idle connection to a service (``keepalive_timeout`` of an upstream)."""
GRID = {"arrangement": "grid", "aperture": 0.01, "count": 3, "interval": 1e-3}


@pytest.fixture(scope="module")
def api(tmp_path_factory):
    """The API alone, with a key."""
    needed()
    api = ApiProcess(tmp_path_factory.mktemp("api"), api_key=KEY, requests_per_second=1e6, keep_alive=3 * IDLE).wait()
    yield api
    api.close()


@pytest.fixture
def compressing(api, tmp_path):
    """A client through an nginx that compresses, which makes weak tags of the service's."""
    more = "gzip on; gzip_types application/json; gzip_min_length 1; gzip_proxied any;"
    with by_default(tmp_path / "nginx", api.url, more) as nginx:
        base = f"http://127.0.0.1:{nginx.port}/api/v1"
        with httpx.Client(base_url=base, headers=BEARER, timeout=250) as client:
            yield client


def test_service_keep_alive_exceeds_nginx_keep_alive(tmp_path):
    assert Settings.create(data=tmp_path).keep_alive >= 1.25 * NGINX_KEEPS


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "rounds", [pytest.param(8, marks=pytest.mark.long), pytest.param(20, marks=pytest.mark.nightly)]
)
def test_no_post_meets_a_connection_that_is_just_being_closed(api, tmp_path, rounds):
    """POSTs of 100 clients, each on a connection that was idle for as long as nginx keeps one: none is a 502.

    All times are a 60th of the real ones, and the service keeps its side three times as long as nginx. Each client has
    an upstream of its own, so that its connection is used by nobody else meanwhile.
    """
    host, port = api.url.removeprefix("http://"), free_port()
    kept = f"server {host}; keepalive 8; keepalive_timeout {IDLE:g}s;"
    passed_on = 'proxy_http_version 1.1; proxy_set_header Connection ""; proxy_set_header X-Forwarded-For $remote_addr;'
    upstreams = [f"upstream u{n} {{ {kept} }}" for n in range(CLIENTS)]
    places = [f"location /{n}/ {{ proxy_pass http://u{n}/; {passed_on} }}" for n in range(CLIENTS)]
    server = f"server {{ listen 127.0.0.1:{port}; {' '.join(places)} }}"

    async def ask(http, number):
        found = []
        for turn in range(rounds):
            answer = await http.post(f"http://127.0.0.1:{port}/{number}/api/v1/uploads", headers={"Upload-Length": "1"})
            found.append(answer.status_code)
            await asyncio.sleep(IDLE + 0.004 * ((number + turn) % 5 - 2))
        return found

    async def ask_all():
        limits = httpx.Limits(max_connections=CLIENTS, max_keepalive_connections=CLIENTS)
        async with httpx.AsyncClient(headers=BEARER, limits=limits, timeout=250) as http:
            found = await asyncio.gather(*(ask(http, number) for number in range(CLIENTS)))
        return collections.Counter(status for statuses in found for status in statuses)

    with Nginx(tmp_path / "nginx", "\n".join([*upstreams, server]), port):
        assert asyncio.run(ask_all()) == {201: rounds * CLIENTS}


def test_an_answer_through_a_proxy_is_held_for_less_than_the_proxy_waits(api):
    assert MAX_WAIT_FORWARDED <= 50
    with httpx.Client(base_url=f"{api.url}/api/v1", headers=BEARER, timeout=250) as http:
        upload = http.post("/uploads", content=b"x").json()["id"]
        job = http.post("/jobs", json={"kind": "import", "upload_id": upload}).json()["id"]
        http.put(f"/jobs/{job}/desired-state", json={"state": "cancelled"})
        until(lambda: http.get(f"/jobs/{job}").json()["state"] == "cancelled")
        held = {"Prefer": f"wait={MAX_WAIT + 30:g}"}
        direct = http.get(f"/jobs/{job}", headers=held)
        passed_on = http.get(f"/jobs/{job}", headers=held | {"X-Forwarded-For": "192.0.2.1"})
        assert direct.headers["Preference-Applied"] == f"wait={MAX_WAIT:g}"
        assert passed_on.headers["Preference-Applied"] == f"wait={MAX_WAIT_FORWARDED:g}"
        limits = [http.get("", headers=more).json()["limits"]["wait_seconds"] for more in ({}, {"Via": "1.1 proxy"})]
        assert limits == [MAX_WAIT, MAX_WAIT_FORWARDED]


def test_a_request_repeated_with_a_wait_is_answered_with_how_things_are_now(api):
    """So whoever got a proxy's 504 in place of an answer asks again, and goes on as if it had come."""
    with httpx.Client(base_url=f"{api.url}/api/v1", headers=BEARER, timeout=250) as http:
        upload = http.post("/uploads", content=b"x").json()["id"]
        asked = {"url": "/jobs", "json": {"kind": "import", "upload_id": upload}}
        once = {"Idempotency-Key": "once"}
        job = http.post(**asked, headers=once).json()
        http.put(f"/jobs/{job['id']}/desired-state", json={"state": "cancelled"})
        again = http.post(**asked, headers=once | {"Prefer": "wait=50"})
        assert (again.status_code, again.headers["Idempotency-Replayed"]) == (201, "true")
        assert (again.json()["id"], again.json()["state"]) == (job["id"], "cancelled")
        assert http.post(**asked, headers=once).json()["state"] == job["state"] == "queued"
        http.delete(f"/jobs/{job['id']}").raise_for_status()
        assert http.post(**asked, headers=once | {"Prefer": "wait=50"}).json()["id"] == job["id"]


def test_the_documented_proxy_waits_longer_than_an_answer_is_held():
    assert f"proxy_read_timeout {NGINX_KEEPS:g}s;" in documented()
    assert NGINX_KEEPS > MAX_WAIT_FORWARDED + 5


@pytest.mark.parametrize("more", ["", "proxy_http_version 1.1;", "gzip on; gzip_types text/event-stream;"])
def test_events_come_at_once_through_nginx(api, tmp_path, more):
    """With its defaults, which hold answers back, and compressed."""
    with by_default(tmp_path / "nginx", api.url, more) as nginx:
        client = httpx.Client(base_url=f"http://127.0.0.1:{nginx.port}/api/v1", headers=BEARER, timeout=250)
        with client, client.stream("GET", "/events", headers={"Accept-Encoding": "identity"}) as stream:
            lines = stream.iter_lines()
            assert next(line for line in lines if line.startswith("event:")) == "event: ready"
            client.post("/uploads", content=b"x")
            upload = client.post("/uploads", content=b"x").json()["id"]
            client.post("/jobs", json={"kind": "import", "upload_id": upload}).raise_for_status()
            assert next(line for line in lines if line.startswith("event: job"))


def test_a_tag_that_nginx_made_weak_is_the_one_to_change_by(api, compressing):
    upload = compressing.post("/uploads", content=b"x").json()["id"]
    here = f"/jobs/{compressing.post('/jobs', json={'kind': 'import', 'upload_id': upload}).json()['id']}"
    seen = compressing.get(here)
    assert (seen.headers["Content-Encoding"], seen.headers["ETag"][:2]) == ("gzip", "W/")
    condition = {"If-Match": seen.headers["ETag"]}
    assert compressing.get(here, headers={"If-None-Match": seen.headers["ETag"]}).status_code == 304
    assert compressing.patch(here, json={"priority": 7}, headers=condition).status_code == 200
    assert compressing.patch(here, json={"priority": 8}, headers=condition).status_code == 412
    assert compressing.get(here).json()["priority"] == 7
