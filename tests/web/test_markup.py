"""Whatever somebody typed or named a file is text on every page: none of it becomes an element or runs."""

import io
import json
import uuid

import numpy as np
import pytest
from playwright.sync_api import expect

from support.waiting import until

MARKUP = [
    "\"><img src=x onerror=document.title='gone'> {{7*7}} ${7*7}",
    "<script>document.title='gone'</script> &lt;b&gt;",
    pytest.param("javascript:document.title='gone'", marks=pytest.mark.nightly),
    pytest.param("\"><svg onload=document.title='gone'>", marks=pytest.mark.nightly),
]


def text_alone(page):
    """Whether nothing on a page has come of markup."""
    return page.locator("main img, main script, main svg svg, main b").count() == 0 and "gone" not in page.title()


def recording(**arrays):
    """The bytes of an archive of arrays."""
    held = io.BytesIO()
    np.savez(held, **arrays)
    return held.getvalue()


@pytest.mark.parametrize("markup", MARKUP)
def test_labels_holders_reasons_links_and_problems(service, open_page, markup):
    """Labels of a scan, names and values; who holds the scanner; why it was stopped; what a link says; a problem."""
    body = {"plan_id": service.plan(pulse_rate=1, averages=24), "labels": {markup[:60]: markup}}
    scan = service.http.post("/scans", json=body, headers={"Idempotency-Key": uuid.uuid4().hex}).json()["id"]
    until(lambda: service.get(f"/scans/{scan}").json()["state"] == "running")
    page = open_page(service, "/scans")
    expect(page.locator("table")).to_contain_text(f"{markup[:60]}: {markup}")
    page.goto(f"{service.url}/scans/{scan}")
    expect(page.locator("section.head")).to_contain_text(markup)
    service.http.put("/scanners/scanner-0/lease", json={"holder": markup, "seconds": 60})
    expect(page.locator("#scanner")).to_contain_text(f"reserved by {markup}")
    service.http.post("/scanners/scanner-0/emergency-stop", json={"reason": markup})
    try:
        expect(page.locator("#stopped")).to_contain_text(markup)
        page.goto(
            f"{service.url}/design?label={json.dumps(markup)}&mask={json.dumps(markup)}&order={json.dumps(markup)}"
        )
        expect(page.get_by_role("button", name="Scan this")).to_be_enabled()
        page.goto(f"{service.url}/scans/{markup.replace('/', '')}")
        expect(page.locator("main .failed")).to_contain_text("there is no scan")
        assert text_alone(page)
    finally:
        fence = service.get("/scanners/scanner-0").json()["lease"]["fence"]
        service.http.delete("/scanners/scanner-0/lease", headers={"Scanner-Lease": str(fence)})
        service.http.delete("/scanners/scanner-0/emergency-stop")
    page.provoked("status of 404")  # what is not there
    page.provoked("status of 422")  # nor can be an identifier


@pytest.mark.parametrize("markup", MARKUP)
def test_file_names_and_contents_with_markup_are_shown_as_text(service, open_page, markup):
    """The name of a file that is sent, what is said of its contents, the label it gives; why a job was cancelled."""
    page = open_page(service, "/data")
    name = markup.replace("/", "")
    foreign = recording(**{markup.replace("/", ""): np.zeros(3)})
    page.set_input_files("#files", {"name": f"{name}.npz", "mimeType": "application/zip", "buffer": foreign})
    expect(page.get_by_text(f"{name}.npz", exact=True)).to_be_visible()
    expect(page.locator("main .state.failed")).to_contain_text(f"it holds {name}")
    assert text_alone(page)
    good = recording(traces=np.eye(9, 64), positions=1e-3 * np.argwhere(np.ones((3, 3))), dt=1e-7, c=1500.0)
    page.set_input_files("#files", {"name": f"{name}.npz", "mimeType": "application/zip", "buffer": good})
    page.get_by_role("button", name="Import").click()
    expect(page.get_by_text("Imported")).to_be_visible()
    scan = service.get("/scans?limit=1").json()["items"][0]
    assert scan["labels"]["file"] == f"{name}.npz"
    assert text_alone(page)
    body = {"scan_id": scan["id"], "parameters": {"method": "iterative", "modes": 600}}
    key = {"Idempotency-Key": uuid.uuid4().hex}
    job = service.http.post("/reconstructions", json=body, headers=key).json()["id"]
    service.http.put(f"/jobs/{job}/desired-state", json={"state": "cancelled", "reason": markup})
    page.goto(f"{service.url}/reconstructions/{job}")
    expect(page.locator("#reconstruction")).to_contain_text(markup)
    page.goto(f"{service.url}/scans")
    expect(page.locator("table")).to_contain_text(f"file: {name}.npz")
    assert text_alone(page)
    page.provoked("status of 422")  # what cannot be read
