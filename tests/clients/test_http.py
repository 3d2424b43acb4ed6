"""The walks of clients/http, word for word: curl's, and the one for editors."""

import re
import shutil
import subprocess
from pathlib import Path

import httpx
import numpy as np
import pytest

from support import recordings

pytestmark = pytest.mark.long

HTTP = Path(__file__).parents[2] / "clients" / "http"


@pytest.mark.long
@pytest.mark.timeout(400)
@pytest.mark.skipif(shutil.which("curl") is None, reason="needs curl: apt-get install curl")
def test_the_walk_with_curl_ends_with_volumes_and_their_axes(url, tmp_path):
    """Own data in, and out come volumes whose brightest voxel lies where the ball is."""
    recordings.save(tmp_path / "own.npz")
    walk = subprocess.run([HTTP / "walk.sh", "own.npz", url], cwd=tmp_path, capture_output=True, text=True, timeout=380)
    assert walk.returncode == 0, walk.stdout + walk.stderr
    recordings.expect_the_ball(tmp_path)
    assert len((HTTP / "walk.sh").read_text().splitlines()) < 30


def test_a_refused_walk_ends_with_the_services_words(url, tmp_path):
    """What is no recording stops the script; the reason is printed."""
    (tmp_path / "own.npz").write_bytes(b"")
    walk = subprocess.run([HTTP / "walk.sh", "own.npz", url], cwd=tmp_path, capture_output=True, text=True)
    assert walk.returncode != 0
    assert not list(tmp_path.glob("*.npy"))


def test_the_requests_for_editors_are_answered_one_after_the_other(url):
    """Each block of the file is sent as it stands, with what earlier answers said in its places."""
    document = (HTTP / "walk.http").read_text()
    assert re.search(r"^@at = (\S+)$", document, re.M)[1] == "http://127.0.0.1:8000"
    answers = {}

    def said(place):
        if place[1] == "at":
            return url
        name, field = re.fullmatch(r"(\w+)\.response\.body\.\$\.(\w+)", place[1]).groups()
        return answers[name].json()[field]

    for block in re.split(r"^###.*$", document, flags=re.M)[1:]:
        name = re.search(r"^# @name (\w+)$", block, re.M)[1]
        block = re.sub(r"\{\{([^}]+)\}\}", said, re.sub(r"^#.*\n", "", block, flags=re.M)).strip()
        head, _, body = block.partition("\n\n")
        (method, address), *headers = (line.split(" ", 1) for line in head.splitlines())
        fields = {key.rstrip(":"): value for key, value in headers}
        answers[name] = httpx.request(method, address, headers=fields, content=body.strip(), timeout=150)
        assert answers[name].is_success, f"{name}: {answers[name].text}"
    assert list(answers) == ["mask", "plan", "scan", "reconstruction", "slice", "projection"]
    assert answers["scan"].json()["state"] == "complete"
    volume = answers["reconstruction"].json()["report"]["shape"]
    assert np.array(answers["slice"].json()["values"]).shape == (volume[0], volume[2])
    assert answers["projection"].content[1:4] == b"PNG"
