"""The page behind Debian's nginx: as ``docs/deploy.md`` shows it, with TLS below a path, and as others set it up."""

import re

import httpx
import pytest
from playwright.sync_api import expect

from steradian.web.pages import PAGES
from support.nginx import Laboratory, by_default, needed
from support.services import Service
from support.views import drawn
from support.waiting import until

KEY = "a key for these tests alone"
PATHS = [address for address in PAGES if "{" not in address]


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    """A service that asks everybody for a key."""
    needed()
    folder = tmp_path_factory.mktemp("behind")
    service = Service(folder / "data", log=folder / "log", api_key=KEY, require_key=True).start()
    service.http.headers["Authorization"] = f"Bearer {KEY}"
    yield service
    service.close()


@pytest.fixture(scope="module")
def laboratory(service, tmp_path_factory):
    """nginx as documented, in front of it."""
    laboratory = Laboratory(tmp_path_factory.mktemp("nginx"), service.url)
    yield laboratory
    laboratory.close()


@pytest.fixture
def open_below(chromium, laboratory):
    """Open a page of the service through the proxy, signed in; nothing may be asked outside its path, or be missing."""
    contexts, faults = [], []

    def open_below(address):
        context = chromium.new_context(ignore_https_errors=True, viewport={"width": 1280, "height": 720})
        context.set_default_timeout(200_000)
        contexts.append(context)
        page = context.new_page()
        base = f"{laboratory.url}/"
        page.on("request", lambda one: None if one.url.startswith((base, "data:", "blob:")) else faults.append(one.url))
        page.on("response", lambda one: faults.append(f"{one.status} {one.url}") if one.status in (404, 502) else None)
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.goto(laboratory.url + address)
        page.get_by_label("API key").fill(KEY)
        page.get_by_role("button", name="Sign in").last.click()
        expect(page.get_by_role("dialog")).to_have_count(0)
        return page

    yield open_below
    for context in contexts:
        context.close()
    assert faults == []


def test_the_whole_story_below_a_path(service, laboratory, open_below):
    """Mask, plan, scan, reconstruction and projection with nothing but the page, by TLS below a path."""
    page = open_below("/")
    expect(page).to_have_url(re.compile(f"^{laboratory.url}/design"))
    for name, value in {"aperture": 9.6, "count": 120, "depth": 2, "pulse_rate": 200, "samples": 256}.items():
        page.locator(f"#field-{name}").fill(str(value))
    button = page.get_by_role("button", name="Scan this")
    expect(button).to_be_enabled()
    button.click()
    expect(page).to_have_url(re.compile(f"^{laboratory.url}/scans/s"))
    page.get_by_role("button", name="Reconstruct", exact=True).click()
    expect(page).to_have_url(re.compile(f"^{laboratory.url}/reconstructions/r"))
    page.get_by_role("link", name="Open the volume").click()
    expect(page).to_have_url(re.compile(f"^{laboratory.url}/volumes/r"))
    drawn(page)
    page.click("[data-tab='Files']")
    row = page.locator("[data-format='nrrd']")
    row.get_by_role("button", name="Create").click()
    with page.expect_download() as download:
        row.get_by_role("link", name="Download").click()
    assert download.value.path().read_bytes().startswith(b"NRRD")
    for address in PATHS:  # the rail leads there from a page of any depth
        page.locator(f"nav.rail a[href$='{address[1:]}']").click()
        expect(page).to_have_url(re.compile(f"^{laboratory.url}{address}"))
        expect(page.locator("#scanner")).not_to_contain_text("reading")
    (cookie,) = page.context.cookies()
    assert (cookie["path"], cookie["secure"], cookie["httpOnly"]) == ("/steradian/api/v1", True, True)
    page.reload()  # the session is found again
    expect(page.get_by_role("dialog")).to_have_count(0)
    page.get_by_role("button", name="Emergency stop").click()
    expect(page.locator("#stopped")).to_contain_text("Emergency stop")
    until(lambda: service.get("/scanners/scanner-0").json()["emergency_stop"])
    service.http.delete("/scanners/scanner-0/emergency-stop")


def test_stop_below_a_path_turns_a_firing_laser_off(service, open_below):
    page = open_below("/data")
    scan = service.start_scan(service.plan(pulse_rate=1, averages=24))["id"]
    until(lambda: service.get(f"/scans/{scan}").json()["progress"]["done"] >= 1)
    expect(page.locator("#scanner")).to_contain_text("laser on")
    page.get_by_role("button", name="Emergency stop").click()
    expect(page.locator("#stopped")).to_contain_text("laser off (confirmed by the device")
    until(lambda: service.get(f"/scans/{scan}").json()["state"] == "aborted")
    shown = service.get("/scanners/scanner-0").json()
    assert (shown["emergency_stop"]["laser"], shown["laser"], shown["shutter"]) == ("off", "off", "closed")
    service.http.delete("/scanners/scanner-0/emergency-stop")


def test_the_documents_below_a_path_try_a_request_there(laboratory, chromium):
    key = {"Authorization": f"Bearer {KEY}"}
    context = chromium.new_context(ignore_https_errors=True, extra_http_headers=key)
    page = context.new_page()
    asked = []
    page.on("request", lambda one: asked.append(one.url))
    page.goto(f"{laboratory.url}/docs")
    page.locator("#operations-tag-service").click()
    page.locator("#operations-service-root_read button").first.click()
    page.get_by_role("button", name="Execute").click()
    expect(page.locator(".live-responses-table")).to_contain_text('"steradian"')
    assert f"{laboratory.url}/api/v1" in asked
    assert [url for url in asked if not url.startswith((laboratory.url, "data:", "blob:"))] == []
    context.close()


def test_page_below_unannounced_proxy_path_works(tmp_path, chromium):
    """Where a proxy takes a path off and says nothing of it, what the page needs is found beside the page.

    The browser's Host is passed on all the same: without it, no page can show that it is of this service.
    """
    needed()
    service = Service(tmp_path / "data", log=tmp_path / "log", api_key=KEY).start()
    more = f"}} location /some/where/ {{ proxy_pass {service.url}/; proxy_set_header Host $http_host;"
    nginx = by_default(tmp_path / "nginx", service.url, more)
    context = chromium.new_context()
    page, base = context.new_page(), f"http://127.0.0.1:{nginx.port}/some/where"
    outside = []
    page.on("request", lambda one: None if one.url.startswith((base, "data:")) else outside.append(one.url))
    page.goto(f"{base}/design")
    page.get_by_label("API key").fill(KEY)
    page.get_by_role("button", name="Sign in").last.click()
    expect(page.get_by_role("button", name="Scan this")).to_be_enabled()
    expect(page.locator("#scanner")).not_to_contain_text("reading")
    assert outside == []
    assert httpx.get(f"{base}/static/urls.js").is_success
    context.close()
    nginx.close()
    service.close()
