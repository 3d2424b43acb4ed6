"""Scan: a person sees it run, holds it, ends it, and finds what comes next."""

import re

import numpy as np
import pytest
from playwright.sync_api import expect

from support.waiting import until

LOOK_AGAIN = "import('/static/event_stream.js').then(({ live }) => live._dispatch('again', null))"


def slow(service, **labels):
    """A scan of minutes that has begun."""
    plan = service.plan(pulse_rate=1, averages=24)
    scan = start(service, plan, labels)
    until(lambda: service.get(f"/scans/{scan}").json()["progress"]["done"] >= 2)
    return scan


def start(service, plan, labels):
    key = {"Idempotency-Key": str(np.random.default_rng().integers(2**60))}
    return service.http.post("/scans", json={"plan_id": plan, "labels": labels}, headers=key).json()["id"]


def state(service, scan):
    return service.get(f"/scans/{scan}").json()["state"]


def test_the_image_that_grows_is_the_services_projection(service, open_page):
    plan = service.plan(count=150, pulse_rate=50)
    scan = start(service, plan, {})
    live = service.done("/reconstructions", scan_id=scan, follow=True)
    page = open_page(service, f"/scans/{scan}")
    expect(page.locator("section.image")).to_contain_text("the complete image")
    shown = page.locator("section.image canvas").evaluate(
        "c => [c.width, c.height, ...c.getContext('2d').getImageData(0, 0, c.width, c.height).data]"
    )
    wide, high = shown[:2]
    pixels = np.array(shown[2:]).reshape(high, wide, 4)[:, :, :3].sum(axis=2)
    report = service.get(f"/reconstructions/{live['id']}").json()["report"]
    first = np.ceil((report["near_field_m"] - report["origin_m"][2]) / report["spacing_m"][2] - 1e-6)
    told = service.get(
        f"/reconstructions/{live['id']}/mip?axis=z&dtype=uint8&max_size=512&slab={first:.0f}:",
        headers={"Accept": "application/json"},
    )
    values = np.array(told.json()["values"]).reshape(told.json()["shape"])
    row, column = np.unravel_index(pixels.argmax(), pixels.shape)
    assert values[column, high - 1 - row] == values.max()  # x to the right, y up
    bar = page.locator("section.image .scale-bar")
    box, image = bar.bounding_box(), page.locator("section.image canvas").bounding_box()
    expect(bar).to_have_text("2 mm")
    width = report["spacing_m"][0] * report["shape"][0]
    assert box["width"] / image["width"] == pytest.approx(2e-3 / width, rel=0.01)
    assert image["height"] > 0.5 * page.viewport_size["height"]  # finished: the image is what is large
    window = [float(one) for one in told.headers["x-window"].split(",")]
    ends = page.locator("section.image .colour-bar span:not(.ramp)").all_inner_texts()
    assert [float(one.split("\N{NO-BREAK SPACE}")[0].split()[0]) for one in ends] == [
        pytest.approx(window[1], rel=5e-3),
        window[0],
    ]
    page.route("**/reconstructions?kind=live*", lambda route: route.abort())
    with page.expect_event("requestfailed"):
        page.evaluate(LOOK_AGAIN)
    page.unroute_all()
    with page.expect_response("**/revision"):
        page.evaluate(LOOK_AGAIN)
    expect(page.locator("section.image canvas")).to_be_visible()  # it stayed while nobody answered
    page.get_by_role("button", name="Direct and iterative").click()
    tiles = page.locator("#side .tiles h2")
    expect(tiles).to_contain_text(["nedner", "iterative"])  # the image that was there, and the new one
    newest = service.get("/reconstructions", params={"scan_id": scan}).json()["items"]
    assert [one["parameters"]["method"] for one in newest] == ["iterative", "nedner"]
    page.goto(f"{service.url}/scans/{scan}")
    page.get_by_role("button", name="Undersample with another mask").click()
    page.get_by_role("link", name="Design a mask").click()
    page.locator("#field-count").fill("40")
    page.get_by_label("Method").select_option("iterative")
    page.get_by_role("button", name=f"Undersample scan …{scan[-5:]}").click()
    page.wait_for_url("**/reconstructions/r*")
    through = service.get(f"/reconstructions/{page.url.rpartition('/')[2]}").json()
    assert (through["kind"], through["scan_id"], through["parameters"]["method"]) == ("what-if", scan, "iterative")
    mask = service.get(f"/masks/{through['mask_id']}").json()
    assert (mask["arrangement"]["count"], mask["aperture"], mask["depth"]) == (40, 13.56e-3, 3.6e-3)
    page.goto(f"{service.url}/scans")
    row = page.locator("tbody tr", has=page.locator(f"a[href$='{scan}']"))
    points = service.get(f"/scans/{scan}").json()["summary"]["points"]
    for text in (str(points), "3.6\N{NO-BREAK SPACE}mm", re.compile(r"20\d\d-\d\d-\d\d \d\d:\d\d")):
        expect(row).to_contain_text(text)
    until(lambda: row.locator("canvas").evaluate("c => c.width") > 1)  # the image of the scan
    page.provoked("net::ERR_FAILED")  # the question that was lost


def test_scan_page_pauses_resumes_and_stops_scan(service, open_page):
    scan = slow(service)
    page = open_page(service, f"/scans/{scan}")
    expect(page.get_by_text("points not yet measured need another scan")).to_be_visible()
    expect(page.locator("[data-filter=missing]")).to_contain_text("to come")  # nothing is missing while it may come
    expect(page.get_by_role("group", name="Laser, interlock")).to_be_visible()
    page.get_by_role("button", name="Pause").press("Enter")
    until(lambda: state(service, scan) == "paused")
    expect(page.locator("section.head strong")).to_have_text("paused")
    page.keyboard.press("Enter")  # as a key that is held down does
    page.keyboard.press("Tab")
    resume = page.get_by_role("button", name="Resume")
    expect(resume).to_be_focused()  # the place in the row of keys is kept
    resume.click()
    until(lambda: state(service, scan) == "running")
    link = page.locator("#running a")
    expect(link).to_have_text("scan")
    link.focus()
    service.http.put(f"/scans/{scan}/desired-state", json={"state": "paused"}).raise_for_status()
    expect(link).to_have_text("scan paused")
    expect(link).to_be_focused()  # what moves takes it from nobody
    page.get_by_role("button", name="Stop …").click()
    expect(page.get_by_role("dialog")).to_contain_text("Stop keeps")
    page.get_by_role("button", name="Stop and keep").click()
    until(lambda: state(service, scan) == "partial")
    expect(page.get_by_role("button", name="Reconstruct", exact=True)).to_be_visible()
    seen = service.get(f"/scans/{scan}/coverage").json()
    expect(page.locator("[data-filter=stored]")).to_have_text(f"stored {seen['stored']}")
    expect(page.locator("[data-filter=missing]")).to_have_text(f"missing {seen['missing']}")
    assert page.locator("section.map .stage").bounding_box()["height"] >= 240
    expect(page.get_by_role("group", name="Laser, interlock")).to_be_hidden()  # of now, when the scan is over
    page.locator("section.map canvas").focus()
    page.keyboard.press("ArrowRight")
    expect(page.locator("section.trace")).to_contain_text("Selected, point")
    page.keyboard.press("Escape")
    expect(page.locator("section.trace")).to_contain_text("Newest, point")
    page.locator("[data-filter=missing]").click()
    expect(page.locator("[data-filter=missing]")).to_have_attribute("aria-pressed", "true")


def test_a_spectrum_is_the_fourier_transform(service, open_page):
    """Of 300 samples, against NumPy's: levels within a thousandth of a decibel where they are above −60 dB."""
    samples = np.random.default_rng(4).normal(size=300).cumsum()
    page = open_page(service, "/data")
    told = page.evaluate(
        "async ([samples, dt]) => { const { spectrum } = await import('/static/scan/spectrum.js');"
        " const { levels, step, peak } = spectrum(samples, dt); return { levels: [...levels], step, peak }; }",
        [samples.tolist(), 8e-9],
    )
    window = np.sin(np.pi * (np.arange(300) + 0.5) / 300) ** 2
    size = np.abs(np.fft.rfft((samples - samples.mean()) * window, 512))[:256]
    levels = 20 * np.log10(size / size.max())
    loud = levels > -60
    assert np.array(told["levels"])[loud] == pytest.approx(levels[loud], abs=1e-3)
    assert told["step"] == pytest.approx(np.fft.rfftfreq(512, 8e-9)[1])
    assert told["peak"] == pytest.approx(np.fft.rfftfreq(512, 8e-9)[size.argmax()])
