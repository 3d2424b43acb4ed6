"""The Python client has a method for every operation of the committed document, and no other."""

import ast
import json
import re
from pathlib import Path

import pytest

import steradian_client
from steradian_client import AsyncClient, Client, routes
from steradian_client.resources.base import Resource
from steradian_client.sync_async import dual_context_manager, dual_iterator, dual_method

ROOT = Path(__file__).parents[2]
PACKAGE = Path(steradian_client.__file__).parent
METHODS = {"get", "put", "post", "patch", "delete", "head"}
LEFT_OUT = {
    "head": "a HEAD is its GET without the body: for caches and browsers",
}
"""What the client does not offer, and why."""
OF_OTHERS = {
    "/api/v1/session": "a browser's, instead of the key that a program has",
    "/api/v1/reconstructions/{reconstruction_id}/volume.ome.zarr/{path}": "for readers of Zarr, by its address",
}
"""Addresses that it does not know, and why."""

OF_PAGES = {("get", "/api/v1/emergency-stop"): "tells a page whether to offer the stop; a program presses it"}
"""Operations that it does not know, and why."""


def operations():
    document = json.loads((ROOT / "docs" / "openapi.json").read_text())
    return {
        (method, re.sub(r"{[^}]*}", "{}", path))
        for path, item in document["paths"].items()
        for method in METHODS & set(item) - set(LEFT_OUT)
        if path not in OF_OTHERS and (method, path) not in OF_PAGES
    }


def table():
    return {name: route for name, route in vars(routes).items() if isinstance(route, routes.Route)}


def test_the_table_of_routes_is_the_services():
    ours = {(route.method.lower(), re.sub(r"{[^}]*}", "{}", route.template)) for route in table().values()}
    assert sorted(operations() - ours) == []
    assert sorted(ours - operations()) == []


def test_every_route_is_reached_by_a_public_method():
    """A route that no method names would be one that nobody can call."""
    named = {
        node.attr
        for path in PACKAGE.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "routes"
    }
    assert set(table()) - named == set()


def test_idempotency_keys_go_where_the_document_takes_them():
    """A key makes a request repeatable only where the service knows it."""
    document = json.loads((ROOT / "docs" / "openapi.json").read_text())
    taking = {
        (method, re.sub(r"{[^}]*}", "{}", path))
        for path, item in document["paths"].items()
        for method in METHODS & set(item)
        if any(one["name"].lower() == "idempotency-key" for one in item[method].get("parameters", []))
    }
    keyed = {
        (route.method.lower(), re.sub(r"{[^}]*}", "{}", route.template)) for route in table().values() if route.keyed
    }
    assert keyed == taking


@pytest.mark.parametrize("kind", [Client, AsyncClient])
def test_client_methods_all_have_docstrings(kind):
    client = kind("http://127.0.0.1:9")
    nouns = [client, *(noun for noun in vars(client).values() if isinstance(noun, Resource))]
    assert len(nouns) == 12
    for noun in nouns:
        for name in dir(type(noun)):
            if isinstance(getattr(type(noun), name), dual_method | dual_iterator | dual_context_manager):
                assert getattr(noun, name).__doc__, (noun, name)
