"""A page of another origin in a real browser, as a viewer of OME-Zarr is, and what it reads of the service."""

import contextlib
import http.server
import threading

import pytest

from support.services import EQUI, Service

KEY = "a key for these tests alone"
ASK = """async ([url, how]) => {
    try {
        const answer = await fetch(url, how);
        return {status: answer.status, body: await answer.text(), shown: Object.fromEntries(answer.headers)};
    } catch (error) {
        return {refused: String(error)};
    }
}"""


class Quiet(http.server.SimpleHTTPRequestHandler):
    """Serves an empty folder."""

    def log_message(self, *_about):
        """Say nothing."""


@contextlib.contextmanager
def site(folder):
    """A site of somebody else on this machine; yields its origin."""
    folder.mkdir()
    (folder / "index.html").write_text("<!doctype html><title>viewer</title>")
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), lambda *how: Quiet(*how, directory=folder))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://localhost:{server.server_port}"
    server.shutdown()
    server.server_close()


@pytest.fixture
def volume(tmp_path):
    """A service that one site may read, with a volume; yields service, origin and the volume's address."""
    with site(tmp_path / "site") as viewer:
        service = Service(tmp_path / "data", log=tmp_path / "log", api_key=KEY, cors_origins=viewer).start()
        scan = service.make("/scans", plan_id=service.plan())
        job = service.done("/reconstructions", scan_id=scan["id"], parameters={"modes": 32})
        yield service, viewer, f"{service.url}{job['links']['ome_zarr']}"
        service.close()


def test_allowed_origin_can_only_read_volume(volume, chromium, tmp_path):
    service, viewer, address = volume
    context = chromium.new_context()
    page = context.new_page()
    page.goto(f"{service.url}/scans")
    key = {"Authorization": f"Bearer {KEY}"}
    page.evaluate("(headers) => fetch('api/v1/session', {method: 'POST', headers})", key)
    assert len(context.cookies()) == 1, "one that no other page may use"
    page.goto(viewer)

    def ask(url, **how):
        return page.evaluate(ASK, [url, how])

    about = ask(f"{address}/zarr.json")
    assert about["status"] == 200
    assert "multiscales" in about["body"]
    piece = ask(f"{address}/zarr.json", headers={"Range": "bytes=0-3"})
    assert piece["status"] in (200, 206)
    assert "etag" in piece["shown"]
    assert ask(f"{address}/0/c/99/99/99")["status"] == 404, "an empty piece"
    made = {"method": "POST", "headers": {"Content-Type": "application/json"}, "body": str(EQUI).replace("'", '"')}
    before = service.get("/masks").json()["items"]
    assert "refused" in ask(f"{service.url}/api/v1/masks", **made)
    assert "refused" in ask(f"{service.url}/api/v1/scans", method="DELETE")
    assert "refused" in ask(f"{address}/zarr.json", credentials="include"), "not even with the cookie"
    assert service.get("/masks").json()["items"] == before
    with site(tmp_path / "other") as other:
        page.goto(other)
        assert "refused" in ask(f"{address}/zarr.json")
    context.close()
