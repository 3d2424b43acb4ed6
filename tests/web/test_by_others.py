"""What others' tools say of the page: TypeScript of its scripts, axe of its accessibility."""

import os
import subprocess
from pathlib import Path

import pytest
from playwright.sync_api import expect

from steradian_client import Client

ROOT = Path(__file__).parents[2]
VIEWS = ["/design?mask=combined", "/scans", "/scans/{scan}", "/reconstructions", "/reconstructions/{made}", "/volumes"]
VIEWS += ["/volumes/{made}", "/data"]
GRAVE = {"serious", "critical"}


@pytest.fixture(scope="module")
def tools():
    """The folder of Node's packages; skipped where they are not installed."""
    folder = Path(os.environ.get("STERADIAN_TOOLS", ROOT / ".tools")).absolute() / "node_modules"
    if not folder.is_dir():
        pytest.skip("needs others' tools: tests/clients/tools/install.sh")
    return folder


@pytest.fixture(scope="module")
def made(service):
    """A scan with its volume and a measurement in it, so that no view is empty."""
    scan = service.make("/scans", plan_id=service.plan(count=150))["id"]
    made = service.done("/reconstructions", scan_id=scan)["id"]
    with Client(service.url) as client:
        middle = {"kind": "point", "name": "middle", "axis": "z", "slab": [0, 1], "start": [0, 0]}
        client.reconstructions.set_measurements(made, [middle])
    return {"scan": scan, "made": made}


def test_every_script_has_types_that_hold(tools):
    command = ["node", str(tools / "typescript" / "bin" / "tsc"), "-p", str(Path(__file__).parent / "tools")]
    told = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (told.returncode, told.stdout) == (0, "")


@pytest.mark.parametrize("view", VIEWS)
def test_no_view_has_a_grave_fault_of_accessibility(tools, service, open_page, made, view):
    """In the dark and in the light theme."""
    page = open_page(service, view.format(**made), reduced_motion="reduce")
    expect(page.locator("body")).to_have_attribute("data-live", "live")
    expect(page.locator("main .state.loading:visible")).to_have_count(0)
    page.evaluate("document.querySelectorAll('main details').forEach((one) => { one.open = true; })")
    page.evaluate((tools / "axe-core" / "axe.min.js").read_text())
    for scheme in ("dark", "light"):
        page.emulate_media(color_scheme=scheme, reduced_motion="reduce")
        found = page.evaluate("axe.run(document, { resultTypes: ['violations'] })")["violations"]
        grave = {one["id"]: [node["html"] for node in one["nodes"]] for one in found if one["impact"] in GRAVE}
        assert grave == {}, scheme
