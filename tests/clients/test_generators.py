"""Clients that others' generators make of the committed document type-check and do the whole main job."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import httpx
import numpy as np
import pytest

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]
ROOT = Path(__file__).parents[2]
DOCUMENT, OURS = ROOT / "docs" / "openapi.json", Path(__file__).parent / "tools"


@pytest.fixture(scope="module")
def key(running):
    """A key that may do the main job: generators take a documented key for one that is needed."""
    scopes = [word for scope in ("read", "plan", "operate", "reconstruct") for word in ("--scope", scope)]
    command = [sys.executable, "-m", "steradian", "key", "create", "walker", *scopes, "--data", running.folder]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


@pytest.fixture
def workshop(tmp_path):
    """A folder with the walks and what their tools are told."""
    for name in ("config.yaml", "mypy.ini", "package.json", "walk.py", "walk.ts"):
        shutil.copy(OURS / name, tmp_path)
    return tmp_path


def same_as_the_service_says(url, printed):
    """Whether a walk ended with a slice, as the service has it, and a picture."""
    said = json.loads(printed)
    volume = httpx.get(
        f"{url}/api/v1/reconstructions/{said['job']}/volume?slice=:,16,:", headers={"Accept": "*/*"}, timeout=250
    )
    values = np.frombuffer(volume.content[-4 * np.prod([said["shape"][0], said["shape"][2]]) :], np.float32)
    assert np.array(said["slice"]).shape == (said["shape"][0], said["shape"][2])
    np.testing.assert_array_equal(np.ravel(said["slice"]).astype(np.float32), values)
    assert np.abs(values).max() > 0
    assert said["picture"] > 1000


def test_openapi_python_client_makes_a_client_that_reconstructs(tools, workshop, url, key):
    command = ["--config", "config.yaml", "--meta", "none", "--output-path", "steradian_generated"]
    made = tools.run("openapi-python-client", "generate", "--path", DOCUMENT, *command, cwd=workshop)
    assert "WARNING" not in made, made
    operations = {path.stem for path in workshop.glob("steradian_generated/api/*/*.py")} - {"__init__"}
    document = json.loads(DOCUMENT.read_text())
    assert operations == {one["operationId"] for path in document["paths"].values() for one in path.values()}
    tools.run("mypy", "steradian_generated", "walk.py", cwd=workshop)
    same_as_the_service_says(url, tools.run("python", "walk.py", url, key, cwd=workshop))


def test_openapi_typescript_makes_types_with_which_a_client_reconstructs(tools, workshop, url, key):
    (workshop / "node_modules").symlink_to(tools.folder / "node_modules")
    tools.run("openapi-typescript", "--default-non-nullable", "false", DOCUMENT, "-o", "schema.d.ts", cwd=workshop)
    how = ["--strict", "--target", "es2022", "--module", "nodenext", "--lib", "es2022,dom"]
    tools.run("tsc", *how, "--outDir", "js", "walk.ts", cwd=workshop)
    same_as_the_service_says(url, tools.run("node", "js/walk.js", url, key, cwd=workshop))
