"""The locust file requests operations of the API only; a recorder replaces locust, which is not installed."""

import json
import re
import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

ROOT = Path(__file__).parents[3]
OPERATIONS = json.loads((ROOT / "docs" / "openapi.json").read_text())["paths"]


class RecordingClient:
    """HTTP client that notes and refuses each request; like locust's, a context only with ``catch_response``."""

    def __init__(self):
        self.requests = []

    def request(self, method, path, catch_response=False, **_):
        self.requests.append((method, path))
        return self if catch_response else SimpleNamespace(status_code=400)

    def get(self, path, **options):
        return self.request("get", path, **options)

    def post(self, path, **options):
        return self.request("post", path, **options)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    status_code, ok = 400, False


@pytest.fixture
def users(monkeypatch):
    """The classes of users in the locust file."""
    locust, environment = ModuleType("locust"), ModuleType("locust.env")
    locust.HttpUser = locust.FastHttpUser = object
    locust.between = locust.constant = lambda *seconds: seconds
    locust.task = lambda weight: weight if callable(weight) else lambda function: function
    locust.events = SimpleNamespace(test_start=SimpleNamespace(add_listener=lambda function: function))
    environment.Environment = object
    requests = ModuleType("requests")
    for module in (locust, environment, requests):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    names = runpy.run_path(str(ROOT / "benchmarks" / "locustfile.py"))
    names["created"].update({kind: [f"{kind}-1"] for kind in names["created"]})
    return [names[name] for name in ("Reader", "Submitter", "Listener", "Misbehaving")]


def is_operation(method, path):
    """Whether the API has this operation."""
    path = path.partition("?")[0]
    return any(
        method in methods and re.fullmatch(re.sub(r"\{\w+\}", "[^/]+", template), path)
        for template, methods in OPERATIONS.items()
    )


def test_locust_users_request_operations_of_the_api(users):
    seen = set()
    for kind in users:
        user = kind()
        user.client = RecordingClient()
        for name, task in vars(kind).items():
            if callable(task) and name not in {"read", "send_half_request"} and not name.startswith("__"):
                for _ in range(40):  # tasks choose at random
                    task(user)
        seen |= set(user.client.requests)
    assert len(seen) >= 14
    assert [request for request in seen if not is_operation(*request)] == []
