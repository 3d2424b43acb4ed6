"""How often one may ask: a person never notices a limit, a script does; health and the stop have none."""

import threading

import httpx
import pytest

from steradian.security.keys import KeyStore, Scope
from steradian.security.rate_limit import MAX_CALLERS, RateLimiter, RateLimitExceeded
from support.waiting import until

from .conftest import api_of

STOP = "/api/v1/scanners/scanner-0/emergency-stop"


class Slow:
    """A clock that goes when it is told to."""

    def __init__(self):
        self.now = 1000.0

    def __call__(self):
        return self.now


def test_a_rate_lets_a_burst_pass_and_then_its_rate():
    clock = Slow()
    rate = RateLimiter(10.0, 100.0, clock)
    for _ in range(100):
        rate.acquire("ada")
    with pytest.raises(RateLimitExceeded) as refusal:
        rate.acquire("ada", 25.0)
    assert refusal.value.retry_after == 3, "25 of them are there after 2.5 s"
    rate.acquire("ben")
    clock.now += 2.5
    rate.acquire("ada", 25.0)
    with pytest.raises(RateLimitExceeded):
        rate.acquire("ada")


def test_callers_that_were_away_for_the_longest_are_forgotten():
    rate = RateLimiter(1.0, 1.0, Slow())
    for number in range(MAX_CALLERS + 1):
        rate.acquire(str(number))
    assert not rate.is_exhausted("0")
    assert rate.is_exhausted("1")


@pytest.fixture(scope="module")
def limited(tmp_path_factory):
    """A service on which a key may do 2 requests a second, 20 at once, and an address send 5 wrong keys."""
    folder = tmp_path_factory.mktemp("limited")
    server = api_of(folder, require_key=True, api_key="k" * 24, requests_per_second=2, failed_keys_per_minute=5)
    server.wait()
    yield server
    server.close()


def key_of(server, name, *scopes):
    return {"Authorization": f"Bearer {KeyStore(server.database).create(name, scopes)}"}


def statuses(client, url, headers, many, method="GET"):
    return [client.request(method, url, headers=headers) for _ in range(many)]


@pytest.mark.long
def test_rate_limit_returns_429_only_to_exceeding_key(limited):
    script, person = key_of(limited, "script", Scope.READ), key_of(limited, "person", Scope.READ)
    here = f"{limited.url}/api/v1/masks"
    with httpx.Client(timeout=250) as client:
        answers = statuses(client, here, script, 60)
        refused = [answer for answer in answers if answer.status_code != 200]
        assert refused, "60 requests take less than the 20 s that they may"
        assert {answer.status_code for answer in refused} == {429}
        assert refused[0].json()["code"] == "too-many-requests"
        assert refused[0].json()["retryable"]
        assert int(refused[0].headers["retry-after"]) >= 1
        assert {answer.status_code for answer in answers[:15]} == {200}
        assert client.get(here, headers=person).status_code == 200
        assert {answer.status_code for answer in statuses(client, f"{limited.url}/healthz", {}, 60)} == {200}
        assert {answer.status_code for answer in statuses(client, limited.url + STOP, script, 3, "POST")} == {202}


def test_wrong_keys_are_limited_harder_and_keep_no_good_one_out(limited):
    good, here = key_of(limited, "good", Scope.READ), f"{limited.url}/api/v1/masks"
    with httpx.Client(timeout=250) as client:
        assert client.get(here, headers=good).status_code == 200
        seen = [client.get(here, headers={"Authorization": f"Bearer sk_{n}_x"}).status_code for n in range(30)]
        assert seen[0] == 401
        assert seen[-1] == 429
        assert seen.count(401) < 15
        until(lambda: client.get(here, headers=good).status_code == 200)  # a second later keys are known by heart
        assert client.post(limited.url + STOP, headers=good).status_code == 202


def test_only_the_stops_own_path_lets_wrong_keys_be_tried_without_a_limit(limited):
    with httpx.Client(timeout=250) as client:
        for path in ("/api/v1/masks/emergency-stop", "/api/v1/scanners/scanner-0/lease/emergency-stop"):
            wrong = [{"Authorization": f"Bearer sk_{n}_y"} for n in range(30)]
            seen = [client.post(limited.url + path, headers=headers).status_code for headers in wrong]
            assert seen[-1] == 429, path
        assert client.post(limited.url + STOP, headers={"Authorization": "Bearer sk_1_y"}).status_code == 401


@pytest.mark.long
def test_rate_limit_without_keys_is_not_applied(server):
    """Whoever is on the machine itself can take its time anyhow."""
    seen = []

    def ask():
        with httpx.Client(timeout=250) as client:
            seen.extend(statuses(client, f"{server.url}/api/v1/masks", {}, 300))

    threads = [threading.Thread(target=ask) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {answer.status_code for answer in seen} == {200}
