"""A service without keys behind a proxy that nobody told it of: whoever comes through needs a key."""

import os
import socket
import subprocess
from contextlib import closing

import httpx
import pytest

from steradian.api.http import loopback_user as peers
from steradian.api.http import proxy_detection as forwarding
from steradian.api.http.loopback_user import GONE, Peer, user_of
from support.apis import ApiProcess
from support.nginx import by_default, needed

STOP = "/api/v1/emergency-stop"
OTHER = 12345
"""Number of a user that need not exist."""
GRID = {"arrangement": "grid", "aperture": 0.01, "count": 3, "interval": 1e-3}


@pytest.fixture(scope="module")
def api(tmp_path_factory):
    """The API as a first start has it: on the loopback, without keys."""
    api = ApiProcess(tmp_path_factory.mktemp("keyless")).wait()
    yield api
    api.close()


@pytest.fixture
def proxied(api, tmp_path):
    """Makes clients of it through an nginx with these words more in its configuration."""
    needed()
    running = []

    def proxied(more=""):
        nginx = by_default(tmp_path / f"nginx-{len(running)}", api.url, more)
        running.append(nginx)
        return httpx.Client(base_url=f"http://127.0.0.1:{nginx.port}", timeout=250)

    yield proxied
    for nginx in running:
        nginx.close()


def deeds(client, mask):
    """Statuses of what a stranger would try first."""
    asked = [client.get("/api/v1/scans"), client.get("/metrics"), client.post("/api/v1/masks", json=GRID)]
    asked += [client.delete(f"/api/v1/masks/{mask}?dependents=true"), client.post("/api/v1/session")]
    return [answer.status_code for answer in asked]


def test_keyless_service_behind_default_nginx_returns_401(api, proxied):
    with httpx.Client(base_url=api.url, timeout=250) as direct:
        mask = direct.post("/api/v1/masks", json=GRID).json()["id"]
        with proxied() as stranger:
            assert deeds(stranger, mask) == [401] * 5
            assert "proxy" in stranger.get("/api/v1/scans").json()["detail"]
            assert stranger.post(STOP).status_code == 401
            assert [stranger.get(path).status_code for path in ("/healthz", "/docs", "/scans")] == [200] * 3
        assert direct.get(f"/api/v1/masks/{mask}").is_success


def test_http_1_0_counts_as_forwarded(api):
    host, port = api.url.removeprefix("http://").split(":")
    for line, status in (("HTTP/1.0", b"401"), ("HTTP/1.1", b"200")):
        with socket.create_connection((host, int(port)), 60) as line_to:
            line_to.sendall(f"GET /api/v1 {line}\r\nHost: {host}:{port}\r\nConnection: close\r\n\r\n".encode())
            assert line_to.recv(12).split()[1] == status


@pytest.mark.parametrize("more", ["proxy_http_version 1.1;", 'proxy_http_version 1.1; proxy_set_header Connection "";'])
def test_a_proxy_without_a_trace_needs_a_key_where_it_runs_as_another_user(api, proxied, more):
    """As root, nginx gives its requests to processes of the user nobody; as anybody else they are the service's."""
    with proxied(more) as stranger:
        answer = stranger.get("/api/v1/scans")
        assert answer.status_code == (401 if os.getuid() == 0 else 200)
        assert os.getuid() != 0 or "another user" in answer.json()["detail"]


def test_a_process_of_another_user_needs_a_key_and_may_stop(api, monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        with socket.create_connection(listener.getsockname()), closing(listener.accept()[0]) as near:
            scope = {"type": "http", "state": {"peer": Peer(near.getpeername(), near.getsockname())}}
            assert forwarding.stranger(scope) is None
            monkeypatch.setattr(peers, "user_of", lambda *_ends: OTHER)
            scope["state"]["peer"] = Peer(near.getpeername(), near.getsockname())
            assert f"number {OTHER}" in forwarding.stranger(scope)
    if os.getuid() == 0:
        curl = ["curl", "-s", "-o", os.devnull, "-w", "%{http_code}"]
        as_other = {"user": OTHER, "group": OTHER, "extra_groups": [], "cwd": "/", "capture_output": True}
        asked = [f"{api.url}/api/v1/scans"], ["-X", "POST", f"{api.url}{STOP}"]
        assert [subprocess.run([*curl, *words], **as_other).stdout for words in asked] == [b"401", b"202"]


@pytest.mark.parametrize(("host", "family"), [("127.0.0.1", socket.AF_INET), ("::1", socket.AF_INET6)])
@pytest.mark.parametrize("ask", [user_of, peers._ask_kernel, peers._look_up])
def test_connection_owner_is_looked_up_from_kernel(host, family, ask):
    """Also when it is over: a request whose sender is gone, as a proxy's may be, is not the administrator's."""
    with socket.create_server((host, 0), family=family) as listener:
        far = socket.create_connection(listener.getsockname()[:2])
        near, client = listener.accept()
        server = near.getsockname()
        assert ask(client[:2], server[:2]) == os.getuid()
        far.sendall(b"x")
        far.close()
        assert ask(client[:2], server[:2]) == GONE
        near.close()


def test_a_system_that_does_not_tell_leaves_the_other_rules(monkeypatch):
    monkeypatch.delattr(socket, "AF_NETLINK")
    monkeypatch.setattr(peers.Path, "read_text", lambda *_how: (_ for _ in ()).throw(FileNotFoundError()))
    scope = {"type": "http", "state": {"peer": Peer(("127.0.0.1", 1), ("127.0.0.1", 2))}}
    assert scope["state"]["peer"].user is None
    assert forwarding.stranger(scope) is None
