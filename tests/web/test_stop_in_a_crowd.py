"""The emergency stop where connections are short: a browser opens six to a service, for all of its pages."""

import pytest
from playwright.sync_api import expect

from support.waiting import until

HANGING = """async (number) => { const { api } = await import('/static/api.js'); window.answered = 0;
  const done = () => (window.answered += 1);
  for (let n = 0; n < number; n++) api.request('GET', `/events?kind=batch&last_event_id=${n}`).finally(done); }"""
DOWNLOADS = """(number) => { for (let n = 0; n < number; n++)
  fetch(`/api/v1/events?kind=job&last_event_id=${n}`).catch(() => null); }"""


@pytest.fixture
def released(service):
    """Leave the stop as it was found."""
    yield
    service.http.delete("/scanners/scanner-0/emergency-stop")


@pytest.mark.parametrize(("pictures", "downloads"), [(6, 0), (6, 3)])
def test_stop_request_is_not_delayed_by_hanging_requests(service, open_page, released, pictures, downloads):
    """Pictures that never come, of which the page asks for a few at a time, and downloads, which it does not count."""
    scan = service.start_scan(service.plan(pulse_rate=1, averages=24))["id"]
    until(lambda: service.get(f"/scans/{scan}").json()["progress"]["done"] >= 1)
    page = open_page(service, "/data")
    expect(page.locator("body")).to_have_attribute("data-live", "live")
    page.evaluate(DOWNLOADS, downloads)
    page.evaluate(HANGING, pictures)
    page.get_by_role("button", name="Emergency stop").click()
    expect(page.locator("#stopped")).to_contain_text("laser off (confirmed by the device")
    assert service.get("/scanners/scanner-0").json()["emergency_stop"]["laser"] == "off"
    assert page.evaluate("window.answered") == 0, "those that gave way are asked again"


@pytest.fixture
def crowd(service, open_page):
    """Seven pages of one browser that hear of events, and the streams that they have asked for."""
    pages, streams = [open_page(service, "/data")], []
    expect(pages[0].locator("body")).to_have_attribute("data-live", "live")  # its own stream is open, and not counted
    context = pages[0].context
    context.on("request", lambda request: streams.append(request) if "/api/v1/events" in request.url else None)
    for _ in range(6):
        pages.append(context.new_page())
        pages[-1].goto(f"{service.url}/data")
    for page in pages:
        expect(page.locator("body")).to_have_attribute("data-live", "live")
    return pages, streams


def test_the_stop_of_the_seventh_page_answers(service, crowd, released):
    """With a stream each, six pages took all connections: the seventh was not even shown."""
    scan = service.start_scan(service.plan(pulse_rate=1, averages=24))["id"]
    until(lambda: service.get(f"/scans/{scan}").json()["progress"]["done"] >= 1)
    pages, streams = crowd
    pages[-1].get_by_role("button", name="Emergency stop").click()
    expect(pages[-1].locator("#stopped")).to_contain_text("laser off (confirmed by the device")
    assert service.get("/scanners/scanner-0").json()["emergency_stop"]["laser"] == "off"
    assert len(streams) == 0, "the first page's stream is everybody's"


def test_another_page_listens_when_the_one_that_did_is_closed(service, crowd, released):
    """What happens reaches pages that have no stream of their own, also after the one that had it has gone."""
    pages, streams = crowd
    heard = (
        "async () => { const { live } = await import('/static/event_stream.js');"
        " live.on('scanner', () => (document.body.dataset.heard = 'yes')); }"
    )
    for page in pages:
        page.evaluate(heard)
    service.http.post("/scanners/scanner-0/emergency-stop", json={"reason": "heard by all"})
    for page in pages:
        expect(page.locator("body")).to_have_attribute("data-heard", "yes")
        page.evaluate("() => delete document.body.dataset.heard")
    pages.pop(0).close()
    service.http.delete("/scanners/scanner-0/emergency-stop")
    for page in pages:
        expect(page.locator("body")).to_have_attribute("data-heard", "yes")
    assert len(streams) == 1
