"""The page's shells and files, without a browser: who gets what, and what a browser may do with it."""

import re
from pathlib import Path

import httpx
import pytest

from steradian.web.pages import PAGES
from support.apis import ApiProcess

ADDRESSES = ["/", *(address.format(identifier="s01") for address in PAGES)]
AS_BROWSER = {"Accept": "text/html,application/xhtml+xml,*/*;q=0.8"}


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    lab = tmp_path_factory.mktemp("lab")
    (lab / "b panel.js").write_text("// second")
    (lab / "a.js").write_text("// first")
    (lab / "secret.txt").write_text("not for pages")
    (lab.parent / "beside.js").write_text("// not below the folder")
    server = ApiProcess(tmp_path_factory.mktemp("api"), page_scripts=lab).wait()
    with httpx.Client(base_url=server.url, timeout=90) as client:
        yield client
    server.close()


@pytest.mark.parametrize("address", ADDRESSES)
def test_page_loads_only_scripts_of_this_service(client, address):
    page = client.get(address, headers=AS_BROWSER)
    assert page.status_code == 200
    assert page.headers["content-type"].startswith("text/html")
    policy = dict(part.strip().split(" ", 1) for part in page.headers["content-security-policy"].split(";"))
    assert policy["default-src"] == policy["frame-ancestors"] == policy["base-uri"] == "'none'"
    assert policy["script-src"] == policy["style-src"] == policy["connect-src"] == "'self'"
    assert set(re.findall(r"<script[^>]*>(.*?)</script>", page.text, re.DOTALL)) == {""}
    assert not re.search(r"\son\w+=|style=", page.text)
    for name in re.findall(r"(?:src|href)=\"(/static/[^\"]*)\"", page.text):
        assert client.get(name).status_code == 200, name
    assert re.findall(r"/static/lab/([^\"]*)", page.text) == ["a.js", "b%20panel.js"]


def test_root_without_browser_accept_header_returns_api_address(client):
    for accept in ("*/*", "application/json", "text/html;q=0, */*"):
        assert client.get("/", headers={"Accept": accept}).json()["api"] == "/api/v1"
    assert client.get("/docs").status_code == 200


def test_page_module_imports_resolve_to_served_files(client):
    """Every module that a script names lies where it looks for it; none comes from elsewhere."""
    left, seen = {"/static/shell.js"}, set()
    for address in ADDRESSES:
        named = re.findall(r"src=\"([./]*static/(?!lab)[^\"]*)\"", client.get(address, headers=AS_BROWSER).text)
        assert all(name.startswith(".") for name in named), "they are found below any path of a proxy"
        left |= {httpx.URL(f"http://x{address}").join(name).path for name in named}
    while left:
        address = left.pop()
        seen.add(address)
        answer = client.get(address)
        assert (answer.status_code, answer.headers["content-type"].partition(";")[0]) == (200, "text/javascript"), (
            address
        )
        for name in re.findall(r"(?:from|import\()\s*\"([^\"\s]+)\"", answer.text):
            assert name.startswith("."), f"{address} imports {name}"
            left |= {httpx.URL(f"http://x{address}").join(name).path} - seen
    assert len(seen) > 10


def test_a_file_is_sent_again_only_when_it_has_changed(client):
    for name in ("style.css", "shell.js", "icon.svg", "lab/a.js"):
        answer = client.get(f"/static/{name}")
        assert answer.status_code == 200
        assert answer.headers["x-content-type-options"] == "nosniff"
        etag = answer.headers["etag"]
        for sent in (etag, f"W/{etag}"):
            same = client.get(f"/static/{name}", headers={"If-None-Match": sent})
            assert (same.status_code, same.content, same.headers["etag"]) == (304, b"", etag)
        assert client.get(f"/static/{name}", headers={"If-None-Match": '"other"'}).status_code == 200


@pytest.mark.parametrize(
    "name",
    [
        "none.js", "", "design", "../pages.py", "..%2fpages.py", "%2e%2e/__init__.py", "..%5cpages.py", "/etc/passwd",
        "%2fetc%2fhostname.js", "bokeh/bokeh.min.js", "lab/secret.txt",
        "lab/..%2fbeside.js", "lab/../../beside.js", "style.css%00.js", "templates/base.html",
    ],
)  # fmt: skip
def test_static_path_outside_page_files_returns_404(client, name):
    answer = client.get(
        httpx.URL(f"{client.base_url}/static/".rstrip("/") + "/").copy_with(raw_path=f"/static/{name}".encode())
    )
    assert answer.status_code == 404
    assert answer.headers["content-type"] == "application/problem+json"


def test_the_document_shows_every_picture_of_the_page():
    """Of every view in both themes, none too heavy for who reads it over a slow line."""
    folder = Path(__file__).parents[3] / "docs"
    shown = re.findall(r"\]\((page/[^)]*)\)", (folder / "page.md").read_text(encoding="utf-8"))
    assert sorted(shown) == sorted(f"page/{path.name}" for path in (folder / "page").iterdir())
    assert len(shown) == len(set(shown))
    assert {name.replace("dark", "light") for name in shown} == {name for name in shown if "light" in name}
    assert max((folder / name).stat().st_size for name in shown) <= 250_000
