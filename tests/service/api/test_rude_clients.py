"""Clients that are slow, many or rude do no harm to the others: a real API process, real sockets."""

import resource
import socket
import time
from contextlib import ExitStack

import httpx
import pytest

from steradian.security.keys import KeyStore, Scope
from support.waiting import until

from .conftest import api_of

pytestmark = pytest.mark.long

WAIT = 120
HALF_HEAD = b"GET /api/v1/masks HTTP/1.1\r\nHost: 127.0.0.1\r\nX-More: "
HALF_BODY = b"POST /api/v1/masks HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 999\r\n\r\n{"
STREAM = b"GET /api/v1/events HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"


@pytest.fixture
def serve(tmp_path):
    """Starts an API with settings of a test's own."""
    with ExitStack() as stack:

        def serve(**settings):
            server = api_of(tmp_path, **settings)
            stack.callback(server.close)
            server.wait()
            return server

        yield serve


@pytest.fixture
def connect():
    with ExitStack() as stack:

        def connect(server, request=b""):
            host, port = server.url.removeprefix("http://").split(":")
            connection = stack.enter_context(socket.create_connection((host, int(port)), timeout=WAIT))
            connection.sendall(request)
            return connection

        yield connect


def is_ended(connection):
    """Whether the server ends the connection, sooner or later."""
    try:
        while connection.recv(65536):
            pass
    except ConnectionError:
        return True
    except TimeoutError:
        return False
    return True


@pytest.mark.parametrize("begun", [b"", HALF_HEAD, HALF_BODY], ids=["nothing", "half a head", "half a body"])
def test_a_request_that_is_never_finished_is_given_up(serve, connect, begun):
    server = serve(client_timeout=1.0)
    assert is_ended(connect(server, begun))


def test_slow_steady_request_body_is_not_timed_out(serve, connect):
    server = serve(client_timeout=3.0)
    body = b'{"arrangement": "grid", "aperture": 0.01, "count": 5, "interval": 1e-3}'
    connection = connect(
        server,
        b"POST /api/v1/masks HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\nConnection: close\r\n"
        + f"Content-Length: {len(body)}\r\n\r\n".encode(),
    )
    begun = time.monotonic()
    for place in range(len(body)):
        connection.sendall(body[place : place + 1])
        time.sleep(0.12)
    assert time.monotonic() - begun > 3.0, "longer in all than one may be silent"
    assert connection.recv(65536).startswith(b"HTTP/1.1 201")


def test_an_endless_head_is_refused(serve, connect):
    connection = connect(serve(), HALF_HEAD)
    with pytest.raises(ConnectionError):
        connection.sendall(b"x" * 2**26)


def test_oversized_body_client_receives_413_response(serve, connect):
    server = serve(client_timeout=2.0)
    head = f"POST /api/v1/jobs HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: {2**24}\r\n\r\n".encode()
    connection = connect(server, head + bytes(2**24))
    assert connection.recv(65536).startswith(b"HTTP/1.1 413")
    connection.sendall(b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
    assert connection.recv(65536).startswith(b"HTTP/1.1 200")
    second = connect(server, head + bytes(2**24))
    assert second.recv(65536).startswith(b"HTTP/1.1 413")
    assert is_ended(second), "nothing more is asked on it"


def test_one_connection_too_many_takes_the_place_of_the_longest_silent_one(serve, connect):
    server = serve(max_connections=20, client_timeout=600)
    silent = [connect(server, HALF_HEAD) for _ in range(60)]
    assert httpx.get(f"{server.url}/healthz", timeout=WAIT).status_code == 200
    assert is_ended(silent[0])


def test_connections_beyond_fd_limit_keep_service_up_and_log_bounded(tmp_path, connect):
    limit = lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (256, 256))  # noqa: E731
    server = api_of(tmp_path, preexec_fn=limit)
    try:
        server.wait()
        held = [connect(server, HALF_HEAD) for _ in range(400)]
        for _ in range(20):
            assert httpx.get(f"{server.url}/healthz", timeout=WAIT).status_code == 200
        assert held
    finally:
        server.close()
    assert len(server.log) < 100_000


def test_event_streams_are_counted_before_they_are_accepted(tmp_path, connect):
    server = api_of(tmp_path)
    try:
        server.wait()
        check_streams(server, connect)
    finally:
        server.close()
    assert "Traceback" not in server.log


def check_streams(server, connect):
    streams = [connect(server, STREAM) for _ in range(500)]
    answers = [stream.recv(12) for stream in streams]
    assert answers.count(b"HTTP/1.1 200") == 200
    assert answers.count(b"HTTP/1.1 503") == 300
    for stream in streams:
        stream.close()
    until(lambda: connect(server, STREAM).recv(12) == b"HTTP/1.1 200", WAIT, lambda: "places stay with those who left")


def test_strange_methods_are_no_series_of_their_own(server):
    """Those that the parser knows; others are no request to it."""
    strange = ("PROPFIND", "MKCOL", "SUBSCRIBE")
    seen = [httpx.request(method, f"{server.url}/api/v1/masks", timeout=250).status_code for method in strange]
    assert seen == [405] * 3
    told = httpx.get(f"{server.url}/metrics", timeout=250).text
    assert 'method="other"' in told
    assert not [method for method in strange if method in told]


def test_a_stream_ends_when_its_key_is_revoked(tmp_path):
    server = api_of(tmp_path)
    keys = KeyStore(server.database)
    key = keys.create("lab", [Scope.READ])
    try:
        server.wait()
        url, mine = f"{server.url}/api/v1", {"Authorization": f"Bearer {key}"}
        session = httpx.post(f"{url}/session", headers=mine, timeout=250).cookies
        with ExitStack() as stack:
            by_key = stack.enter_context(httpx.stream("GET", f"{url}/events", headers=mine, timeout=WAIT))
            by_session = stack.enter_context(httpx.stream("GET", f"{url}/events", cookies=session, timeout=WAIT))
            keys.revoke(keys.list()[0].id)
            for stream in (by_key, by_session):
                assert "event: ready" in list(stream.iter_lines()), "it ends"
        assert httpx.get(f"{url}/masks", headers=mine, timeout=250).status_code == 401
    finally:
        server.close()
    assert "Traceback" not in server.log


def test_websocket_upgrade_request_releases_connection_slot(serve, connect):
    """Also where a library for websockets is installed, of which the service makes no use."""
    server = serve(max_connections=10)
    upgrade = b"Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: "
    for _ in range(12):
        with connect(server, STREAM[:-2] + upgrade + b"dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n") as connection:
            connection.recv(1)
    until(lambda: httpx.get(f"{server.url}/healthz", timeout=WAIT).status_code == 200)
