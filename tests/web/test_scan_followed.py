"""A scan as it is followed: what the page reads, counts and draws, with the event stream and without it."""

import re
from urllib.parse import parse_qs, urlsplit

import h5py
import numpy as np
from playwright.sync_api import expect

from steradian.scans.file.writer import ScanFileWriter
from support.alines import Aline
from support.waiting import until

DRAWN = """window.texts = new Set(); const fill = CanvasRenderingContext2D.prototype.fillText;
CanvasRenderingContext2D.prototype.fillText = function (text, ...rest) { window.texts.add(text);
  return fill.call(this, text, ...rest); };"""


def begin(service, **plan):
    """Begin a scan, by default one that lasts until it is ended."""
    scan = service.start_scan(service.plan(**{"pulse_rate": 1, "averages": 24} | plan))["id"]
    until(lambda: done(service, scan) >= 2)
    return scan


def done(service, scan):
    return service.get(f"/scans/{scan}").json()["progress"]["done"]


def end(service, scan):
    service.http.put(f"/scans/{scan}/desired-state", json={"state": "stopped"}).raise_for_status()
    until(lambda: service.get(f"/scans/{scan}").json()["state"] in ("partial", "complete"))


def file_of(service, scan):
    return service.folder / "scans" / f"{scan}.h5"


def test_scan_page_fetches_only_new_points(service, open_page):
    scan = begin(service)
    page = open_page(service, "/scans")
    answers = []
    page.on("response", lambda answer: answers.append(answer) if f"{scan}/shots" in answer.url else None)
    page.goto(f"{service.url}/scans/{scan}")
    until(lambda: page.evaluate("1") and len(answers) > 4)
    end(service, scan)
    seen = service.get(f"/scans/{scan}/coverage").json()
    expect(page.locator("[data-filter=stored]")).to_have_text(f"stored {seen['stored']}")
    first, *others = [answer.json() for answer in answers]
    assert len(first["points"]) == 53
    new = {point for one in others for point in one["points"]}
    assert new | stored_in(first) == stored_in(service.get(f"/scans/{scan}/shots").json())
    assert max(len(one["points"]) for one in others) < 20


def stored_in(told):
    return {point for point, stored in zip(told["points"], told["stored"], strict=True) if stored}


def test_flags_are_counted_by_kind_and_the_newest_a_line_is_drawn_with_its_units(service, open_page):
    scan = service.make("/scans", plan_id=service.plan())["id"]
    with ScanFileWriter(file_of(service, scan)) as store:
        samples = np.linspace(-30_000, 30_000, store.samples).astype(np.int16)
        store.append(Aline(n, samples, quality=1 + 2 * (n > 2), shot=n, time_zero_offset_s=1e-6) for n in range(5))
        newest = int(store.course.visit[-1])
    page = open_page(service, "/scans")
    page.add_init_script(DRAWN)
    page.goto(f"{service.url}/scans/{scan}")
    expect(page.locator("[data-filter=saturated]")).to_have_text("saturated 5")
    expect(page.locator("[data-filter=mistuned]")).to_have_text("mistuned 2")
    expect(page.get_by_text(f"Newest, point {newest}:")).to_be_visible()
    page.locator("[data-filter=mistuned]").click()
    texts = page.evaluate("[...window.texts]")
    assert {"time after the laser pulse (µs)", "counts"} <= set(texts)
    below = [text.replace(",", "") for text in texts if text.startswith("−")]
    assert below
    assert all(re.fullmatch("−[1-9]0*", text) for text in below), "round ticks"
    assert "0" in texts
    assert not [text for text in texts if re.match(r"-\d", text)], "a minus is no hyphen"
    page.get_by_role("button", name="Spectrum").click()
    until(lambda: page.evaluate("window.texts.has('frequency (MHz)') && window.texts.has('level (dB)')"))


def follow(service, scan, modes=16, **parameters):
    body = {"scan_id": scan, "follow": True, "interval": 0.5, "parameters": {"modes": modes, **parameters}}
    return service.http.post("/reconstructions", json=body).raise_for_status().json()["id"]


def test_scan_page_requests_each_image_revision_once(service, open_page):
    """Nobody asks again and again: there are not more questions than images, and a few at the beginning and end."""
    scan = begin(service)
    live = follow(service, scan)
    page = open_page(service, "/scans")
    answers = []
    page.on("response", lambda one: answers.append(one.status) if one.url.endswith("/revision") else None)
    page.goto(f"{service.url}/scans/{scan}")
    expect(page.locator("section.image")).to_contain_text("revision")
    until(lambda: page.evaluate("1") and answers.count(200) >= 3)
    end(service, scan)
    expect(page.locator("section.image")).to_contain_text("the final image")
    last = service.get(f"/reconstructions/{live}/revision").json()
    assert last["final"]
    assert len(answers) <= last["number"] + 4


def test_the_final_image_begins_below_the_near_field(service, open_page):
    """As on the volume's page: what the sensors' own noise brightens is not seen."""
    scan = begin(service)
    live = follow(service, scan, display={"near_field": 0.5e-3})  # stated: by itself it depends on when the scan ends
    page = open_page(service, "/scans")
    asked = []
    page.on("request", lambda one: asked.append(parse_qs(urlsplit(one.url).query)) if "/mip?" in one.url else None)
    page.goto(f"{service.url}/scans/{scan}")
    expect(page.locator("section.image")).to_contain_text("revision")
    assert "slab" not in asked[-1], "of a revision the service leaves it out"
    end(service, scan)
    expect(page.locator("section.image")).to_contain_text("the final image")
    with h5py.File(service.folder / "jobs" / live / "volume.h5") as file:
        near, z = float(file["values"].attrs["near_field_m"]), file["z"][:]
    first = int(asked[-1]["slab"][0].removesuffix(":")) if "slab" in asked[-1] else 0
    assert z[first] >= near - 1e-9
    assert first == 0 or z[first - 1] < near
    assert near > 0
    coverage = service.get(f"/scans/{scan}/coverage").json()
    stored, planned = coverage["stored"], coverage["stored"] + coverage["missing"]
    expect(page.locator("section.image header")).to_contain_text(f"from {stored} of {planned} A-lines")


def test_scan_page_with_unfinished_image_shows_its_final_state(service, open_page):
    scan = begin(service)
    live = follow(service, scan)
    page = open_page(service, "/scans")

    def as_if(change):
        def answer(route):
            told = route.fetch()
            route.fulfill(response=told, **({"json": change(told.json())} if told.status == 200 else {}))

        return answer

    page.route("**/revision", as_if(lambda told: told | {"final": False}))
    page.goto(f"{service.url}/scans/{scan}")
    image = page.locator("section.image")
    expect(image).to_contain_text("revision")
    expect(image).not_to_contain_text("final image")
    end(service, scan)
    expect(image).to_contain_text("The final image is being computed")
    until(lambda: service.get(f"/reconstructions/{live}").json()["state"] == "succeeded")
    failed = as_if(lambda told: told | {"items": [told["items"][0] | {"state": "failed"}]})
    page.route("**/reconstructions?kind=live*", failed)
    page.evaluate("import('/static/event_stream.js').then(({ live }) => live._dispatch('again', null))")
    expect(image).to_contain_text("The final image was not created: the reconstruction failed")
    working = {"state": "running", "progress": {"stage": "image", "done": 0, "total": 0}}
    page.unroute("**/reconstructions?kind=live*")
    young = as_if(lambda told: told | {"items": [told["items"][0] | working]})
    page.route("**/reconstructions?kind=live*", young)
    page.goto(f"{service.url}/scans/{scan}")  # who comes now has seen none of it
    expect(image).to_contain_text("The final image is being computed")
    page.unroute_all(behavior="wait")


def test_the_image_grows_also_while_the_event_stream_is_cut(service, open_page):
    scan = begin(service)
    follow(service, scan)
    page = open_page(service, "/healthz")
    page.route("**/api/v1/events*", lambda route: route.abort())
    page.goto(f"{service.url}/scans/{scan}")
    expect(page.locator("#cut")).to_contain_text("Not live since")
    expect(page.locator("section.image")).to_contain_text("revision")
    revision = page.locator("section.image .caption", has_text="revision")
    expect(revision).not_to_have_text(revision.text_content())
    end(service, scan)
    expect(page.locator("section.image")).to_contain_text("the final image")
    page.provoked("net::ERR_FAILED")  # the stream that was cut


def test_a_scan_that_was_not_followed_offers_its_reconstruction_next(service, open_page):
    scan = begin(service)
    page = open_page(service, f"/scans/{scan}")
    expect(page.get_by_role("button", name="Start a live image")).to_be_visible()
    end(service, scan)
    expect(page.locator("section.image")).to_contain_text("can be reconstructed now")
    page.get_by_role("button", name="Reconstruct the image").click()
    page.wait_for_url("**/reconstructions/r*")


def test_the_missing_points_are_measured_by_a_scan_that_begins_with_the_others(service, open_page):
    scan = begin(service, averages=2)
    end(service, scan)
    before = file_of(service, scan).read_bytes()
    held = service.get(f"/scans/{scan}").json()["summary"]["stored"]
    assert 0 < held < 53
    page = open_page(service, f"/scans/{scan}")
    page.get_by_role("button", name="Measure the missing points …").click()
    expect(page.get_by_role("dialog")).to_contain_text(f"starts with these {held} A-lines and measures the other")
    page.get_by_role("button", name="Measure", exact=True).click()
    page.wait_for_url(lambda url: "/scans/s" in url and not url.endswith(scan))
    made = page.url.rpartition("/")[2]
    expect(page.locator("section.head")).to_contain_text("completes")
    until(lambda: service.get(f"/scans/{made}").json()["state"] == "complete")
    expect(page.locator("[data-filter=stored]")).to_have_text("stored 53")
    assert file_of(service, scan).read_bytes() == before
    with h5py.File(file_of(service, scan)) as old, h5py.File(file_of(service, made)) as new:
        rows = old["alines/status"][:] == 1
        np.testing.assert_array_equal(new["alines/samples"][rows], old["alines/samples"][rows])
        assert (new.attrs["scan_id"], new.attrs["completes"]) == (made, scan)


def test_interlock_key_shutter_and_lease_stand_beside_the_scan(service, open_page):
    scan = begin(service)
    lease = service.http.put("/scanners/scanner-0/lease", json={"holder": "Ada", "seconds": 60}).json()["lease"]
    page = open_page(service, f"/scans/{scan}")
    guards = page.get_by_role("group", name="Laser, interlock, key, shutter and lease")
    for text in ("interlock closed", "key on", "shutter open", "reserved by Ada until"):
        expect(guards).to_contain_text(text)
    service.http.delete("/scanners/scanner-0/lease", headers={"Scanner-Lease": str(lease["fence"])})
    end(service, scan)
    expect(page.locator("section.head [aria-label^='Laser, interlock']")).to_be_hidden()  # of now, not of the scan
    for text in ("laser off", "shutter closed"):
        expect(page.locator("#scanner")).to_contain_text(text)
    expect(page.locator("#scanner")).not_to_contain_text("reserved")
