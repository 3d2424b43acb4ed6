"""Without keys the machine's owner is admin; a page, a proxy or a rebound name on the same machine is nobody."""

import socket

import httpx
import pytest

MASK = {"arrangement": "grid", "aperture": 0.011, "count": 3, "interval": 1e-3}
STOP = "/api/v1/scanners/scanner-0/emergency-stop"


def ask(server, method, path, headers, **more):
    answer = httpx.request(method, server.url + path, headers=headers, timeout=60, **more)
    if answer.status_code >= 400:
        assert answer.headers["content-type"] == "application/problem+json"
    return answer


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 201),
        ({"Sec-Fetch-Site": "same-origin"}, 201),
        ({"Sec-Fetch-Site": "none"}, 201),
        ({"Host": "evil.example"}, 403),
        ({"Host": "[::1"}, 403),
        ({"Host": "127.0.0.1:port"}, 403),
        ({"Host": ""}, 403),
        ({"Origin": "https://evil.example"}, 403),
        ({"Origin": "http://["}, 403),
        ({"Origin": "null"}, 403),
        ({"Sec-Fetch-Site": "cross-site"}, 403),
        ({"Sec-Fetch-Site": "same-site"}, 403),
    ],
    ids=lambda value: "; ".join(f"{k}: {v}" for k, v in value.items()) if isinstance(value, dict) else None,
)
def test_a_foreign_page_changes_nothing(server, headers, status):
    answer = ask(server, "POST", "/api/v1/masks", headers, json=MASK)
    assert answer.status_code in ({201, 200} if status == 201 else {status})


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_a_foreign_page_neither_stops_the_scanner_nor_reads_by_itself(server, site):
    assert ask(server, "POST", STOP, {"Sec-Fetch-Site": site}).status_code == 403
    assert ask(server, "GET", "/api/v1/scans", {"Sec-Fetch-Site": site, "Sec-Fetch-Mode": "no-cors"}).status_code == 403
    navigation = {"Sec-Fetch-Site": site, "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "document"}
    assert ask(server, "GET", "/api/v1/scans", navigation).status_code == 200, "a person may follow a link"


@pytest.mark.parametrize(
    "header", ["Forwarded", "X-Forwarded-For", "X-Forwarded-Host", "X-Forwarded-Proto", "Via", "X-Real-IP"]
)
def test_behind_a_proxy_the_loopback_is_nobody(server, header):
    for method, path in (("GET", "/api/v1/scans"), ("POST", "/api/v1/masks"), ("GET", "/metrics")):
        answer = ask(server, method, path, {header: "for=127.0.0.1"})
        assert (answer.status_code, answer.json()["code"]) == (401, "unauthorized"), (method, path)
    assert httpx.get(f"{server.url}/healthz", headers={header: "x"}, timeout=90).status_code == 200


def test_two_hosts_are_none(server):
    port = int(server.url.rpartition(":")[2])
    with socket.create_connection(("127.0.0.1", port), timeout=60) as connection:
        connection.sendall(b"GET /api/v1/scans HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n")
        assert connection.recv(64).split()[1] in {b"400", b"403"}
