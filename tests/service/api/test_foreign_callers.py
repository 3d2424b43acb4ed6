"""Without keys the machine's owner is admin; who is nobody on the same machine stands in :mod:`attacks`."""

import httpx
import pytest

MASK = {"arrangement": "grid", "aperture": 0.011, "count": 3, "interval": 1e-3}


def ask(server, method, path, headers, **more):
    answer = httpx.request(method, server.url + path, headers=headers, timeout=250, **more)
    if answer.status_code >= 400:
        assert answer.headers["content-type"] == "application/problem+json"
    return answer


@pytest.mark.parametrize("headers", [{}, {"Sec-Fetch-Site": "same-origin"}, {"Sec-Fetch-Site": "none"}])
def test_the_owner_and_a_page_of_the_service_s_own_may_all(server, headers):
    assert ask(server, "POST", "/api/v1/masks", headers, json=MASK).status_code in {200, 201}


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_a_person_may_follow_a_link_of_another_page(server, site):
    navigation = {"Sec-Fetch-Site": site, "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "document"}
    assert ask(server, "GET", "/api/v1/scans", navigation).status_code == 200


def test_health_is_open_through_a_proxy_too(server):
    assert httpx.get(f"{server.url}/healthz", headers={"Via": "x"}, timeout=250).status_code == 200
