"""Uploads through nginx: a size that it refuses, and what breaks off and is gone on with (tus 1.0)."""

import base64
import contextlib
import hashlib
import itertools
import os
import socket

import httpx
import pytest

from steradian_client import Client
from steradian_client.errors import NotFound, ServiceError
from support.apis import ApiProcess
from support.nginx import by_default, needed
from support.proxy import Proxy
from support.waiting import until

from .conftest import BEARER, KEY

SIZE = 3 * 2**20 + 17
PIECES = {"Content-Type": "application/offset+octet-stream"}


@pytest.fixture(scope="module")
def api(tmp_path_factory):
    """The API alone, with a key."""
    api = ApiProcess(tmp_path_factory.mktemp("api"), api_key=KEY, max_import_bytes=4 * SIZE).wait()
    yield api
    api.close()


@pytest.fixture
def http(api):
    with httpx.Client(base_url=f"{api.url}/api/v1", headers=BEARER, timeout=250) as http:
        yield http


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A file of which each byte matters."""
    path = tmp_path_factory.mktemp("file") / "recording.npy"
    path.write_bytes(os.urandom(SIZE))
    return path


def stored(api, identifier):
    return (api.data.uploads / identifier).read_bytes()


def begin(http, length):
    answer = http.post("/uploads", headers={"Upload-Length": str(length), "Tus-Resumable": "1.0.0"})
    assert (answer.status_code, answer.headers["Upload-Offset"]) == (201, "0")
    return answer.headers["Location"].removeprefix("/api/v1")


def offset(http, where):
    answer = http.head(where)
    assert answer.headers["Cache-Control"] == "no-store"
    return int(answer.headers["Upload-Offset"])


def test_an_upload_that_breaks_off_goes_on_where_it_ended(api, http, recording):
    content = recording.read_bytes()
    where = begin(http, SIZE)
    host, port = api.url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port))) as line:
        head = f"PATCH /api/v1{where} HTTP/1.1\r\nHost: {host}:{port}\r\nContent-Length: {SIZE}\r\nUpload-Offset: 0\r\n"
        head += "".join(f"{name}: {value}\r\n" for name, value in (BEARER | PIECES).items())
        line.sendall(f"{head}\r\n".encode() + content[:1_000_000])
        until(lambda: offset(http, where) == 1_000_000)
    assert http.get(where).json() | {"links": 0} == {
        **{"id": where.rpartition("/")[2], "bytes": 1_000_000, "length": SIZE, "sha256": None, "links": 0}
    }
    asked = {"content": content[1_000_000:], "headers": PIECES | {"Upload-Offset": "1000000"}}
    done = until(lambda: (answer := http.patch(where, **asked)).status_code != 409 and answer)  # the other is let go
    assert (done.status_code, done.headers["Upload-Offset"]) == (204, str(SIZE))
    assert done.headers["Repr-Digest"] == f"sha-256=:{base64.b64encode(hashlib.sha256(content).digest()).decode()}:"
    assert stored(api, where.rpartition("/")[2]) == content
    assert (http.get(where).json()["bytes"], http.get(where).json()["length"]) == (SIZE, None)
    assert list(api.data.uploads.glob("*.part")) == []


@pytest.mark.parametrize("wrong", ["0", "2", "100"])
def test_bytes_at_another_place_are_refused(http, wrong):
    where = begin(http, 10)
    http.patch(where, content=b"abc", headers=PIECES | {"Upload-Offset": "0"}).raise_for_status()
    refused = http.patch(where, content=b"x", headers=PIECES | {"Upload-Offset": wrong})
    assert refused.status_code == 409
    assert "allowed: 3" in refused.json()["detail"]
    assert offset(http, where) == 3


def test_more_bytes_than_were_announced_are_refused(http):
    where = begin(http, 3)
    refused = http.patch(where, content=b"abcd", headers=PIECES | {"Upload-Offset": "0"})
    assert (refused.status_code, refused.json()["errors"][0]["pointer"]) == (422, "#/body")
    assert offset(http, where) == 0


@pytest.mark.parametrize("length", ["0", "-1", "x", str(10**12)])
def test_a_length_that_is_not_allowed_is_refused(http, length):
    refused = http.post("/uploads", headers={"Upload-Length": length})
    assert refused.status_code == 422
    assert "Upload-Length" in str(refused.json()["errors"])


def test_a_part_is_no_upload_yet_and_can_be_deleted(api, http):
    where = begin(http, 10)
    job = {"kind": "import", "upload_id": where.rpartition("/")[2]}
    assert http.post("/jobs", json=job).status_code == 404
    assert http.delete(where).status_code == 204
    assert http.get(where).status_code == 404
    assert http.patch(where, content=b"x", headers=PIECES | {"Upload-Offset": "0"}).status_code == 404


def test_the_client_goes_on_with_an_upload_that_breaks_off(api, recording):
    """The network is cut three times on the way; the bytes that had come are not sent again."""
    network = Proxy(api.url)
    left, sent = [0.2, 0.4, 0.7], []

    def cut(done, total):
        sent.append(done)
        if left and done > left[0] * total:
            with contextlib.suppress(AssertionError):  # what goes into a connection that was cut never arrives
                until(lambda: sum(part.stat().st_size for part in api.data.uploads.glob("*.part")) > done // 2, 20)
                left.pop(0)
                network.cut()
                network.mend()

    with Client(network.url, key=KEY) as client:
        client.uploads.create(recording)  # it has answered before
        upload = client.uploads.create(recording, progress=cut)
    network.close()
    assert left == []
    assert stored(api, upload.id) == recording.read_bytes()
    resumed = [later for earlier, later in itertools.pairwise(sent) if later < earlier]
    assert len(resumed) <= 3
    assert resumed == sorted(resumed)
    assert resumed[-1] > 2**18, "it did not begin anew"


def test_upload_too_large_for_nginx_raises_proxy_error(api, recording, tmp_path):
    """nginx takes 1 MB by default."""
    needed()
    with by_default(tmp_path / "nginx", api.url) as nginx:
        with Client(f"http://127.0.0.1:{nginx.port}", key=KEY) as client:
            with pytest.raises(ServiceError, match=r"a proxy in front of the service \(nginx.*client_max_body_size"):
                client.uploads.create(recording)
            with pytest.raises(NotFound):
                client.uploads.get("none")
